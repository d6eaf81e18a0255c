#include "apps/forest-localization/level_scan.h"

#include <algorithm>
#include <cmath>

namespace rigor::forest {

LevelScan::LevelScan(const ScannerMount& mount, std::vector<IgnoredSector> sectors)
    : mount_(mount), sectors_(std::move(sectors)) {
  const double cr = std::cos(mount.roll_rad), sr = std::sin(mount.roll_rad);
  const double cp = std::cos(mount.pitch_rad), sp = std::sin(mount.pitch_rad);
  const double turn[3][3] = {{cp, sp * sr, sp * cr}, {0, cr, -sr}, {-sp, cp * sr, cp * cr}};
  std::copy(&turn[0][0], &turn[0][0] + 9, &turn_[0][0]);
  as_is_ = sectors_.empty() && mount.roll_rad == 0 && mount.pitch_rad == 0 && std::isinf(mount.lowest_m);
  points_.resize(StemDetector::kMaxBeams);
}

bool LevelScan::ignored(const LidarPoint& p) const noexcept {
  if (sectors_.empty()) return false;
  const double bearing = std::atan2(p.y_m, p.x_m), range = std::hypot(p.x_m, p.y_m, p.z_m);
  return std::any_of(sectors_.begin(), sectors_.end(), [&](const IgnoredSector& s) {
    return range < s.within_m && bearing >= s.from_rad && bearing <= s.to_rad;
  });
}

std::span<const LidarPoint> LevelScan::level(std::span<const LidarPoint> sweep,
                                             const IgnoredStrip* strip) noexcept {
  if (as_is_ && !strip) return sweep;
  const std::size_t count = std::min(sweep.size(), points_.size());
  const PlanarPose& at = mount_.T_base_sensor;
  const double c = std::cos(at.yaw_rad), s = std::sin(at.yaw_rad);
  double ax = 0, ay = 0, length2 = 0;
  if (strip) {
    ax = strip->x1_m - strip->x0_m;
    ay = strip->y1_m - strip->y0_m;
    length2 = std::max(ax * ax + ay * ay, 1e-12);
  }
  for (std::size_t i = 0; i < count; ++i) {
    const LidarPoint& p = sweep[i];
    LidarPoint& q = points_[i] = p;
    const double x = turn_[0][0] * p.x_m + turn_[0][1] * p.y_m + turn_[0][2] * p.z_m;
    const double y = turn_[1][0] * p.x_m + turn_[1][1] * p.y_m + turn_[1][2] * p.z_m;
    const double z = turn_[2][0] * p.x_m + turn_[2][1] * p.y_m + turn_[2][2] * p.z_m;
    bool out = z + mount_.height_m < mount_.lowest_m || ignored(p);
    if (strip && !out) {
      const double dx = at.x_m + c * x - s * y - strip->x0_m, dy = at.y_m + s * x + c * y - strip->y0_m;
      const double u = std::clamp((dx * ax + dy * ay) / length2, 0.0, 1.0);
      out = std::hypot(dx - u * ax, dy - u * ay) < strip->half_width_m;
    }
    constexpr float kNone = std::numeric_limits<float>::quiet_NaN();
    q.x_m = out ? kNone : static_cast<float>(x);
    q.y_m = out ? kNone : static_cast<float>(y);
    q.z_m = out ? kNone : static_cast<float>(z);
  }
  return {points_.data(), count};
}

}  // namespace rigor::forest
