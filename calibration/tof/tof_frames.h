// Range pictures as the fits take them: plain data. No HAL, no files.
#pragma once

#include <cstdint>
#include <limits>
#include <string>
#include <vector>

namespace rigor::calibration {

/// One picture of ranges. Rows from the top; NaN, 0 or less: nothing came back.
struct TofFrame {
  std::string name;  ///< file or recording and index
  int width_px = 0, height_px = 0;
  std::vector<float> range_m{};
  std::vector<float> amplitude{};  ///< of the same size, or empty; in any one unit
  double t_s = std::numeric_limits<double>::quiet_NaN();
  /// Along the optical axis to the plane that fills the picture; NaN: not known.
  double distance_m = std::numeric_limits<double>::quiet_NaN();
};

}  // namespace rigor::calibration
