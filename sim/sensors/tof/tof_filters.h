// What a time-of-flight camera does to its own picture: removal of flying pixels, median, bilateral filter.
#pragma once

#include <vector>

#include "sensor-hal/models/tof/tof_model.h"
#include "sim/sensors/tof/tof_simulator.h"

namespace rigor::tof {

/// Filters in the order of the model; `scratch` keeps its memory. What is off does nothing.
void filter(const models::TofFilters& filters, TofPicture& picture, std::vector<float>& scratch);

}  // namespace rigor::tof
