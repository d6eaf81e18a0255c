// How far an estimated pose in the plane is from the true one of the same instant.
#pragma once

#include <cstdint>
#include <optional>
#include <span>

#include "sensor-hal/types/sample.h"

namespace rigor {

/// Of any clock. The yaw is NaN where it is not known.
struct PlanePose {
  std::int64_t t_ns = 0;
  double x_m = 0, y_m = 0, yaw_rad = 0;
};

/// Its projection onto the ground; the yaw is that of its x axis.
[[nodiscard]] PlanePose plane_pose(std::int64_t t_ns, const Pose& pose);

/// Between true poses that are this far from the instant on both sides there is one of that instant.
inline constexpr std::int64_t kPoseReach_ns = 100'000'000;

/// The pose at t, linear between its two neighbours; a tenth of kPoseReach_ns after the last of `poses` that
/// one. Empty: there is none near enough. `poses` rise in time. Any thread.
[[nodiscard]] std::optional<PlanePose> pose_at(std::span<const PlanePose> poses, std::int64_t t_ns);

/// Estimate less truth: forward and to the left by the true yaw (0 where that is not known), and the turn
/// within ±π (NaN where either yaw is not known).
struct PlanePoseError {
  double along_m = 0, across_m = 0, yaw_rad = 0;
};
[[nodiscard]] PlanePoseError pose_error(const PlanePose& estimate, const PlanePose& truth);

}  // namespace rigor
