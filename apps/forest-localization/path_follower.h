// Steers along a polyline: pure pursuit (R. C. Coulter, CMU-RI-TR-92-01, 1992) with what a robot that turns
// by slipping adds to it: it turns on the spot where the way lies behind it, and slows down where it must
// turn.
//
// A point `lookahead_m` ahead of the nearest one on the way, in the base's frame (x, y), lies on the circle
// with curvature 2y/(x² + y²). Progress only grows, and within a window, so a way may cross itself and close.
// Towards the end the speed falls so that `deceleration_mps2` suffices; within `stop_within_m` it stands.
#pragma once

#include <cstddef>
#include <vector>

#include "apps/forest-localization/statistics.h"

namespace rigor::forest {

struct PathFollowerConfig {
  double speed_mps = 0.5, max_turn_radps = 0.8;
  double acceleration_mps2 = 0.4, deceleration_mps2 = 0.4;
  double turn_acceleration_radps2 = 2;
  double lookahead_m = 1.0;
  double stop_within_m = 0.15;
  double spot_turn_rad = 1.0;  ///< beyond this angle to the point ahead it turns without driving
  double window_m = 3;         ///< in which the nearest point is looked for, ahead of the last
};

struct WayPoint {
  double x_m = 0, y_m = 0;
};

struct DriveCommand {
  double v_mps = 0, w_radps = 0;
};

class PathFollower {
 public:
  /// Setup context: memory for `max_points`.
  PathFollower(const PathFollowerConfig& config, std::size_t max_points);
  /// Any way of up to `max_points` points, at least one; false and no change beyond. Begins anew. Loop
  /// thread, no allocation.
  bool set_path(const WayPoint* points, std::size_t count) noexcept;

  /// The way ends here until it is told again, where the path is longer; beyond where it stood it goes on.
  /// Loop thread.
  void set_end(double progress_m) noexcept;

  /// `may_drive` false: brakes. Loop thread, no allocation.
  [[nodiscard]] DriveCommand step(const Eigen::Vector3d& pose, double dt_s, bool may_drive) noexcept;
  [[nodiscard]] bool done() const noexcept { return done_; }
  [[nodiscard]] double progress_m() const noexcept { return progress_m_; }
  /// Of the way, at `way_m` from its begin: x, y and the direction in which it goes on. count ≥ 1.
  [[nodiscard]] Eigen::Vector3d pose_at(double way_m) const noexcept;
  [[nodiscard]] double length_m() const noexcept { return count_ ? at_m_[count_ - 1] : 0; }
  /// Of the last step: distance to the nearest point of the way, left of it positive.
  [[nodiscard]] double cross_track_m() const noexcept { return cross_track_m_; }

 private:
  [[nodiscard]] WayPoint point_at(double way_m) const noexcept;
  void follow(const Eigen::Vector3d& pose) noexcept;
  [[nodiscard]] DriveCommand limited(DriveCommand wanted, double dt_s) noexcept;

  PathFollowerConfig config_;
  std::vector<WayPoint> points_;
  std::vector<double> at_m_;  ///< way from the first point to each
  std::size_t count_ = 0;
  double end_m_ = 0;  ///< of the way
  double progress_m_ = 0, cross_track_m_ = 0;
  bool done_ = true;
  DriveCommand last_;
};

}  // namespace rigor::forest
