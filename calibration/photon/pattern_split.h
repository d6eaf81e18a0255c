// A fixed pattern in parts: of rows, of columns and of pixels, as EMVA 1288 release 4 has it. The simulated
// camera's patterns are of pixels alone.
#pragma once

#include <span>
#include <vector>

#include "calibration/photon/level_statistics.h"

namespace rigor::calibration {

struct PatternGrid {
  int width_px = 0, height_px = 0;
  int stride = 1;  ///< 2: a mosaic, whose rows of one colour are every other
};

/// Of a picture of deviations whose temporal noise has the variance `noise` (of each pixel); `bad` pixels are
/// left out. Rows and columns are high-passed (what is smooth is the light's, or shading), their share of the
/// pixels' pattern and noise is taken out.
[[nodiscard]] PatternSplit split_pattern(std::span<const float> picture, std::span<const float> noise,
                                         const std::vector<bool>& bad, const PatternGrid& grid);

}  // namespace rigor::calibration
