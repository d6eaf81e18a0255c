#include "apps/forest-localization/path_follower.h"

#include <algorithm>
#include <cmath>

namespace rigor::forest {

PathFollower::PathFollower(const PathFollowerConfig& config, std::size_t max_points)
    : config_(config), points_(max_points), at_m_(max_points) {}

bool PathFollower::set_path(const WayPoint* points, std::size_t count) noexcept {
  if (count == 0 || count > points_.size()) return false;
  count_ = count;
  double way = 0;
  for (std::size_t i = 0; i < count; ++i) {
    points_[i] = points[i];
    if (i > 0) way += std::hypot(points[i].x_m - points[i - 1].x_m, points[i].y_m - points[i - 1].y_m);
    at_m_[i] = way;
  }
  progress_m_ = cross_track_m_ = 0;
  end_m_ = way;
  done_ = false;
  return true;
}

void PathFollower::set_end(double progress_m) noexcept {
  end_m_ = std::clamp(progress_m, 0.0, length_m());
  if (end_m_ > progress_m_ + config_.stop_within_m) done_ = false;
}

Eigen::Vector3d PathFollower::pose_at(double way_m) const noexcept {
  constexpr double kStep_m = 0.05;
  const double at = std::clamp(way_m, 0.0, length_m());
  const WayPoint p = point_at(at), behind = point_at(std::max(at - kStep_m, 0.0)),
                 ahead = point_at(std::min(at + kStep_m, length_m()));
  return {p.x_m, p.y_m, std::atan2(ahead.y_m - behind.y_m, ahead.x_m - behind.x_m)};
}

WayPoint PathFollower::point_at(double way_m) const noexcept {
  const auto end = at_m_.begin() + static_cast<std::ptrdiff_t>(count_);
  const auto next = std::upper_bound(at_m_.begin(), end, way_m);
  if (next == at_m_.begin()) return points_[0];
  if (next == end) return points_[count_ - 1];
  const auto i = static_cast<std::size_t>(next - at_m_.begin());
  const double u = (way_m - at_m_[i - 1]) / (at_m_[i] - at_m_[i - 1]);
  return {points_[i - 1].x_m + u * (points_[i].x_m - points_[i - 1].x_m),
          points_[i - 1].y_m + u * (points_[i].y_m - points_[i - 1].y_m)};
}

/// The nearest point of the way within the window ahead.
void PathFollower::follow(const Eigen::Vector3d& pose) noexcept {
  double best2 = std::hypot(pose.x() - points_[0].x_m, pose.y() - points_[0].y_m);
  best2 *= best2;
  double best_m = 0;
  bool any = count_ == 1;
  for (std::size_t i = 1; i < count_; ++i) {
    if (at_m_[i] < progress_m_ || at_m_[i] == at_m_[i - 1]) continue;
    if (at_m_[i - 1] > progress_m_ + config_.window_m) break;
    const WayPoint& a = points_[i - 1];
    const WayPoint& b = points_[i];
    const double length = at_m_[i] - at_m_[i - 1];
    const double dx = (b.x_m - a.x_m) / length, dy = (b.y_m - a.y_m) / length;
    double along = (pose.x() - a.x_m) * dx + (pose.y() - a.y_m) * dy;
    along = std::clamp(along, std::max(0.0, progress_m_ - at_m_[i - 1]),
                       std::min(length, progress_m_ + config_.window_m - at_m_[i - 1]));
    const double ex = pose.x() - a.x_m - along * dx, ey = pose.y() - a.y_m - along * dy;
    const double d2 = ex * ex + ey * ey;
    if (!any || d2 < best2) {
      any = true;
      best2 = d2;
      best_m = at_m_[i - 1] + along;
      cross_track_m_ = dx * ey - dy * ex;
    }
  }
  if (any) progress_m_ = std::max(progress_m_, best_m);
}

DriveCommand PathFollower::limited(DriveCommand wanted, double dt_s) noexcept {
  wanted.w_radps = std::clamp(wanted.w_radps, -config_.max_turn_radps, config_.max_turn_radps);
  const double up = config_.acceleration_mps2 * dt_s, down = config_.deceleration_mps2 * dt_s;
  const double turn = config_.turn_acceleration_radps2 * dt_s;
  last_.v_mps = std::clamp(wanted.v_mps, last_.v_mps - down, last_.v_mps + up);
  last_.w_radps = std::clamp(wanted.w_radps, last_.w_radps - turn, last_.w_radps + turn);
  return last_;
}

DriveCommand PathFollower::step(const Eigen::Vector3d& pose, double dt_s, bool may_drive) noexcept {
  if (count_ == 0 || done_ || !may_drive || !pose.allFinite()) return limited({}, dt_s);
  follow(pose);
  const double left_m = end_m_ - progress_m_;
  const WayPoint last = point_at(end_m_);
  const double to_end_m = std::hypot(last.x_m - pose.x(), last.y_m - pose.y());
  if (left_m < config_.stop_within_m && (to_end_m < config_.stop_within_m || left_m <= 0)) {
    done_ = true;
    return limited({}, dt_s);
  }
  const WayPoint ahead = point_at(progress_m_ + config_.lookahead_m);
  const double c = std::cos(pose.z()), s = std::sin(pose.z());
  const double x = c * (ahead.x_m - pose.x()) + s * (ahead.y_m - pose.y());
  const double y = -s * (ahead.x_m - pose.x()) + c * (ahead.y_m - pose.y());
  const double angle = std::atan2(y, x);
  if (std::abs(angle) > config_.spot_turn_rad && std::hypot(x, y) > config_.stop_within_m / 2)
    return limited({0, std::copysign(config_.max_turn_radps, angle)}, dt_s);
  const double curvature = 2 * y / std::max(x * x + y * y, 0.01);
  double v = std::min(config_.speed_mps,
                      std::sqrt(2 * config_.deceleration_mps2 *
                                std::max(std::max(left_m, to_end_m) - 0.5 * config_.stop_within_m, 0.0)));
  v = std::max(v, 0.05);
  // The turn that the curvature asks for is kept; the speed gives way.
  if (std::abs(v * curvature) > config_.max_turn_radps) v = config_.max_turn_radps / std::abs(curvature);
  return limited({v, v * curvature}, dt_s);
}

}  // namespace rigor::forest
