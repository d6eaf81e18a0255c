// A sweep as a level scanner at the same place would have it: points of a tilted one are turned into the
// horizontal, where an upright stem is a circle again; what the vehicle itself returns, and the ground, is
// left out. A scanner that is level and sees nothing of its own passes as it is.
#pragma once

#include <cstddef>
#include <limits>
#include <span>
#include <vector>

#include "apps/forest-localization/stem_detector.h"
#include "sensor-hal/types/sample.h"

namespace rigor::forest {

/// Where a scanner is fixed; R = Rz(yaw)·Ry(pitch)·Rx(roll): positive pitch looks down.
struct ScannerMount {
  PlanarPose T_base_sensor;
  double height_m = 0, roll_rad = 0, pitch_rad = 0;
  double lowest_m = -std::numeric_limits<double>::infinity();  ///< points below this height are ground
};

/// Bearings in the scanner's own plane, about its z.
struct IgnoredSector {
  double from_rad = 0, to_rad = 0, within_m = 0;
};

/// A strip of the ground, in the base's frame, above which nothing counts: the vehicle's own crane.
struct IgnoredStrip {
  double x0_m = 0, y0_m = 0, x1_m = 0, y1_m = 0, half_width_m = 0;
};

class LevelScan {
 public:
  /// Setup context: takes its memory.
  LevelScan(const ScannerMount& mount, std::vector<IgnoredSector> sectors);
  /// Points in the scanner's frame without its tilt (x along its yaw); left out are NaN. Valid until the next
  /// call. `strip`: null where there is none. Loop thread; no allocation.
  [[nodiscard]] std::span<const LidarPoint> level(std::span<const LidarPoint> sweep,
                                                  const IgnoredStrip* strip) noexcept;
  [[nodiscard]] const ScannerMount& mount() const noexcept { return mount_; }

 private:
  [[nodiscard]] bool ignored(const LidarPoint& as_measured) const noexcept;

  ScannerMount mount_;
  std::vector<IgnoredSector> sectors_;
  double turn_[3][3] = {};  ///< from the scanner's axes into those of a level one
  bool as_is_ = true;
  std::vector<LidarPoint> points_;
};

}  // namespace rigor::forest
