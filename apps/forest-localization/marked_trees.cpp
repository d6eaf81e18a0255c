#include "apps/forest-localization/marked_trees.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

namespace rigor::forest {

MarkedTrees::MarkedTrees(const ConfigNode& n, const StemMap& map) : map_(&map), visited_(map.size(), 0) {
  along_path_ = n.flag_or("along_path", false);
  stand_off_m_ = n.number_or("stand_off_m", 2, {.min = 0, .max = 50});
  dwell_ = seconds_from(n.number_or("dwell_s", 5, {.min = 0, .max = 1e6}));
  n.finish();
}

void MarkedTrees::plan_stops(PathFollower& follower) {
  constexpr double kStep_m = 0.1;
  for (std::uint32_t i = 0; i < map_->size(); ++i) {
    const Stem& s = (*map_)[i];
    if (!s.fell) continue;
    Stop stop{0, i};
    double best = std::numeric_limits<double>::infinity();
    for (double at = 0; at <= follower.length_m(); at += kStep_m) {
      const Eigen::Vector2d p = seen_from(follower.pose_at(at), s.x_m, s.y_m).p_base;
      const double cost = crane_ ? crane_->cost(p.x(), p.y()) : p.norm() - stand_off_m_;
      if (cost < best) best = cost, stop.progress_m = at;
    }
    const bool reached = crane_ ? std::isfinite(best) : best < 1;
    if (reached)
      stops_.push_back(stop);
    else
      ++out_of_reach_;
  }
  std::stable_sort(stops_.begin(), stops_.end(),
                   [](const Stop& a, const Stop& b) { return a.progress_m < b.progress_m; });
  next_stop_ = 0;
  t_there_ = BenchTime();
  follower.set_end(stops_.empty() ? follower.length_m() : stops_[0].progress_m);
}

void MarkedTrees::step(PathFollower& follower, const PoseGaussian& pose, bool may_drive,
                       BenchTime now) noexcept {
  if (along_path_)
    work_along(follower, pose, may_drive, now);
  else if (may_drive)
    aim(follower, pose, now);
}

/// Drives from stop to stop, works there, and to the path's end.
void MarkedTrees::work_along(PathFollower& follower, const PoseGaussian& pose, bool may_drive,
                             BenchTime now) noexcept {
  if (crane_) crane_->step(now);
  if (next_stop_ == stops_.size() || busy()) return;
  if (!follower.done() || !may_drive) {
    if (follower.done()) return;
    t_there_ = now;
    begun_here_ = target_seen_ = false;
    target_ = stops_[next_stop_].stem;
    return;
  }
  if (now - t_there_ < (crane_ ? kSettles : dwell_)) return;
  if (crane_ && !begun_here_) {
    begun_here_ = true;
    Eigen::Vector2d p = seen_from(pose.mean, (*map_)[target_].x_m, (*map_)[target_].y_m).p_base;
    if (target_seen_) p = target_in_base_;
    if (crane_->begin(p.x(), p.y(), now)) return;
    ++out_of_reach_;
  }
  visited_[target_] = 1;
  ++next_stop_;
  begun_here_ = target_seen_ = false;
  t_there_ = now;
  const bool more = next_stop_ < stops_.size();
  if (more) target_ = stops_[next_stop_].stem;
  follower.set_end(more ? stops_[next_stop_].progress_m : follower.length_m());
}

void MarkedTrees::see(std::span<const StemObservation> stems, const PoseGaussian& pose,
                      const PathFollower& follower) noexcept {
  if (!crane_ || target_ == StemMap::kNone || !follower.done() || busy()) return;
  const Eigen::Vector2d expected = seen_from(pose.mean, (*map_)[target_].x_m, (*map_)[target_].y_m).p_base;
  double best = kSameStem_m;
  for (const StemObservation& s : stems) {
    const double d = std::hypot(s.x_m - expected.x(), s.y_m - expected.y());
    if (d >= best) continue;
    best = d;
    target_seen_ = true;
    target_in_base_ = {s.x_m, s.y_m};
  }
}

/// The next marked stem, when it stands before the last one for long enough.
void MarkedTrees::aim(PathFollower& follower, const PoseGaussian& pose, BenchTime now) noexcept {
  if (!follower.done()) {
    t_there_ = now;
    return;
  }
  if (target_ != StemMap::kNone && now - t_there_ < dwell_) return;
  double best = 0;
  std::uint32_t next = StemMap::kNone;
  for (std::uint32_t i = 0; i < map_->size(); ++i) {
    const Stem& s = (*map_)[i];
    if (!s.fell || visited_[i]) continue;
    const double d = std::hypot(s.x_m - pose.mean.x(), s.y_m - pose.mean.y());
    if (next == StemMap::kNone || d < best) next = i, best = d;
  }
  if (next == StemMap::kNone) return;
  target_ = next;
  visited_[next] = 1;
  const Stem& s = (*map_)[next];
  const double keep = std::min(1.0, (stand_off_m_ + s.radius_m) / std::max(best, 1e-6));
  const std::array<WayPoint, 2> way{
      WayPoint{pose.mean.x(), pose.mean.y()},
      WayPoint{s.x_m + keep * (pose.mean.x() - s.x_m), s.y_m + keep * (pose.mean.y() - s.y_m)}};
  (void)follower.set_path(way.data(), way.size());
  t_there_ = now;
}

}  // namespace rigor::forest
