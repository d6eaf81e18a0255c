// Samples that are a few numbers as JSON: imu, nav_fix, odometry. Units stand in the names; what is not known
// is null.
#pragma once

#include <nlohmann/json_fwd.hpp>

#include "sensor-hal/types/sample.h"

namespace rigor {

/// Null for other kinds.
[[nodiscard]] nlohmann::json sample_json(const Sample& sample);

}  // namespace rigor
