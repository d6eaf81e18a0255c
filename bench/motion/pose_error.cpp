#include "bench/motion/pose_error.h"
#include "sensor-hal/types/orientation.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace rigor {
namespace {

double wrapped(double rad) { return std::remainder(rad, 2 * std::numbers::pi); }

}  // namespace

PlanePose plane_pose(std::int64_t t_ns, const Pose& pose) {
  return {t_ns, pose.position_m[0], pose.position_m[1], yaw_of(pose.orientation_wxyz)};
}

std::optional<PlanePose> pose_at(std::span<const PlanePose> poses, std::int64_t t_ns) {
  if (poses.empty()) return std::nullopt;
  const auto after = std::lower_bound(poses.begin(), poses.end(), t_ns,
                                      [](const PlanePose& p, std::int64_t t) { return p.t_ns < t; });
  if (after == poses.end()) {
    // The last cycle's estimate may be a little later than the last true pose.
    if (t_ns - poses.back().t_ns > kPoseReach_ns / 10) return std::nullopt;
    return poses.back();
  }
  if (after->t_ns == t_ns) return *after;
  if (after == poses.begin()) return std::nullopt;
  const PlanePose &a = *(after - 1), &b = *after;
  if (t_ns - a.t_ns > kPoseReach_ns || b.t_ns - t_ns > kPoseReach_ns) return std::nullopt;
  const double u = static_cast<double>(t_ns - a.t_ns) / static_cast<double>(b.t_ns - a.t_ns);
  return PlanePose{t_ns, a.x_m + u * (b.x_m - a.x_m), a.y_m + u * (b.y_m - a.y_m),
                   a.yaw_rad + u * wrapped(b.yaw_rad - a.yaw_rad)};
}

PlanePoseError pose_error(const PlanePose& estimate, const PlanePose& truth) {
  const double dx = estimate.x_m - truth.x_m, dy = estimate.y_m - truth.y_m;
  const double yaw = std::isfinite(truth.yaw_rad) ? truth.yaw_rad : 0, c = std::cos(yaw), s = std::sin(yaw);
  return {c * dx + s * dy, -s * dx + c * dy, wrapped(estimate.yaw_rad - truth.yaw_rad)};
}

}  // namespace rigor
