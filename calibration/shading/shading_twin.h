// The simulated twin of a flat field: the fitted fall-off with the noise that each cell of the recording has.
#pragma once

#include <cstdint>
#include <vector>

#include "calibration/shading/shading_fit.h"

namespace rigor::calibration {

/// Light of each cell of the twin less the fitted light, in units of the light on the axis. A table of gains
/// states no noise: its twin has none (all 0), and what the recording deviates by is what the model cannot
/// express. The same for the same seed; NaN where a cell has no ray.
[[nodiscard]] std::vector<double> shading_twin(const std::vector<ShadingCell>& cells, const ShadingFit& fit,
                                               std::uint64_t seed);

}  // namespace rigor::calibration
