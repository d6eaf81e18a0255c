#include "apps/forest-localization/relocalizer.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

namespace rigor::forest {
namespace {

/// P(B(trials, p) ≥ successes).
double binomial_tail(std::uint32_t trials, std::uint32_t successes, double p) noexcept {
  if (successes == 0) return 1;
  if (successes > trials) return 0;
  double term = std::pow(1 - p, trials);
  double tail = 0;  // summed itself: 1 less the rest would lose what matters
  for (std::uint32_t k = 0; k <= trials; ++k) {
    if (k >= successes) tail += term;
    term *= p / (1 - p) * static_cast<double>(trials - k) / static_cast<double>(k + 1);
  }
  return tail;
}

}  // namespace

void Relocalizer::begin(std::span<const StemObservation> stems, const StemMap& map,
                        std::optional<PositionHint> hint) noexcept {
  map_ = &map;
  hint_ = hint;
  const auto range2 = [](const StemObservation& o) { return o.x_m * o.x_m + o.y_m * o.y_m; };
  count_ = 0;
  for (const StemObservation& o : stems) {  // insertion by range
    std::uint32_t at = count_;
    if (count_ < kMaxStems) {
      ++count_;
    } else if (range2(o) >= range2(stems_[--at])) {
      continue;
    }
    for (; at > 0 && range2(stems_[at - 1]) > range2(o); --at) stems_[at] = stems_[at - 1];
    stems_[at] = o;
  }
  pair_count_ = 0;
  for (std::uint32_t a = 0; a < count_; ++a)
    for (std::uint32_t b = a + 1; b < count_; ++b) {
      const double d = std::hypot(stems_[a].x_m - stems_[b].x_m, stems_[a].y_m - stems_[b].y_m);
      if (d > 1.5 && d < map.pair_limit_m() - 0.5) pairs_[pair_count_++] = {d, a, b};
    }
  std::sort(pairs_.begin(), pairs_.begin() + pair_count_, [](const Pair& p, const Pair& q) {
    return p.distance_m != q.distance_m ? p.distance_m > q.distance_m
                                        : std::pair(p.a, p.b) < std::pair(q.a, q.b);
  });
  pair_count_ = std::min(pair_count_, config_.max_pairs);
  pair_ = 0;
  tried_ = 0;
  best_count_ = second_count_ = 0;
  best_sum_ = 0;
  candidates_ = {};
  candidate_ = 0;
  state_ = pair_count_ == 0 || count_ < 4 ? State::failed : State::working;
  if (state_ == State::working) next_pair();
}

/// Candidates for the pair `pair_`.
void Relocalizer::next_pair() noexcept {
  const Pair& p = pairs_[pair_];
  const auto variance = [](const StemObservation& o) { return o.covariance[0][0] + o.covariance[1][1]; };
  const double sigma = std::sqrt(variance(stems_[p.a]) + variance(stems_[p.b]) +
                                 2 * config_.map_sigma_m * config_.map_sigma_m);
  const double reach = std::min(3 * sigma, config_.tolerance_m);
  candidates_ = map_->pairs_between(p.distance_m - reach, p.distance_m + reach);
  candidate_ = 0;
}

bool Relocalizer::fits_radius(const StemObservation& o, std::uint32_t stem) const noexcept {
  const double d = o.radius_m - (*map_)[stem].radius_m;
  return d * d < 9 * (o.covariance[2][2] + config_.map_radius_sigma_m * config_.map_radius_sigma_m);
}

void Relocalizer::work(std::uint32_t poses) noexcept {
  for (std::uint32_t k = 0; state_ == State::working && k < poses; ++k) {
    if (candidate_ == 2 * candidates_.size()) {
      if (convincing() && refine()) {
        state_ = State::found;
      } else if (++pair_ == pair_count_) {
        state_ = State::failed;
      } else {
        next_pair();
      }
      continue;
    }
    const StemPair& pair = candidates_[candidate_ / 2];
    if (candidate_ % 2 == 0) {
      try_pose(pair.a, pair.b);
    } else {
      try_pose(pair.b, pair.a);
    }
    ++candidate_;
  }
}

void Relocalizer::try_pose(std::uint32_t stem_a, std::uint32_t stem_b) noexcept {
  const StemObservation& a = stems_[pairs_[pair_].a];
  const StemObservation& b = stems_[pairs_[pair_].b];
  const Stem& A = (*map_)[stem_a];
  const Stem& B = (*map_)[stem_b];
  if (!fits_radius(a, stem_a) || !fits_radius(b, stem_b)) return;
  const double yaw =
      wrapped_rad(std::atan2(B.y_m - A.y_m, B.x_m - A.x_m) - std::atan2(b.y_m - a.y_m, b.x_m - a.x_m));
  const double c = std::cos(yaw), s = std::sin(yaw);
  const double mx = (a.x_m + b.x_m) / 2, my = (a.y_m + b.y_m) / 2;
  const Eigen::Vector3d pose((A.x_m + B.x_m) / 2 - c * mx + s * my, (A.y_m + B.y_m) / 2 - s * mx - c * my,
                             yaw);
  if (hint_ && std::hypot(pose.x() - hint_->x_m, pose.y() - hint_->y_m) > 4 * hint_->sigma_m + 1) return;
  ++tried_;
  std::uint32_t agreeing = 0;
  double sum = 0;
  for (std::uint32_t i = 0; i < count_; ++i) {
    const StemObservation& o = stems_[i];
    const double x = pose.x() + c * o.x_m - s * o.y_m, y = pose.y() + s * o.x_m + c * o.y_m;
    const std::uint32_t stem = map_->nearest(x, y, config_.tolerance_m);
    if (stem == StemMap::kNone || !fits_radius(o, stem)) continue;
    ++agreeing;
    sum +=
        (x - (*map_)[stem].x_m) * (x - (*map_)[stem].x_m) + (y - (*map_)[stem].y_m) * (y - (*map_)[stem].y_m);
  }
  const Eigen::Vector3d d = pose - best_;
  const bool elsewhere = d.head<2>().norm() > 1 || std::abs(wrapped_rad(d.z())) > 0.2;
  if (agreeing > best_count_ || (agreeing == best_count_ && sum < best_sum_)) {
    if (elsewhere) second_count_ = best_count_;
    best_ = pose;
    best_count_ = agreeing;
    best_sum_ = sum;
  } else if (elsewhere) {
    second_count_ = std::max(second_count_, agreeing);
  }
}

bool Relocalizer::convincing() const noexcept {
  if (best_count_ < 4 || second_count_ + 1 >= best_count_) return false;
  const double p =
      std::min(map_->density_per_m2() * std::numbers::pi * config_.tolerance_m * config_.tolerance_m, 0.9);
  return static_cast<double>(tried_) * binomial_tail(count_ - 2, best_count_ - 2, p) < config_.false_alarms;
}

bool Relocalizer::refine() noexcept {
  Eigen::Vector3d at = best_;
  Eigen::Matrix3d A;
  for (int iteration = 0; iteration < 8; ++iteration) {
    A.setZero();
    Eigen::Vector3d g = Eigen::Vector3d::Zero();
    std::uint32_t used = 0;
    const double c = std::cos(at.z()), s = std::sin(at.z());
    for (std::uint32_t i = 0; i < count_; ++i) {
      const StemObservation& o = stems_[i];
      const double x = at.x() + c * o.x_m - s * o.y_m, y = at.y() + s * o.x_m + c * o.y_m;
      const std::uint32_t stem = map_->nearest(x, y, config_.tolerance_m);
      if (stem == StemMap::kNone || !fits_radius(o, stem)) continue;
      const SeenPoint seen = seen_from(at, (*map_)[stem].x_m, (*map_)[stem].y_m);
      Eigen::Matrix2d R;
      R << o.covariance[0][0], o.covariance[0][1], o.covariance[1][0], o.covariance[1][1];
      R.diagonal().array() += config_.map_sigma_m * config_.map_sigma_m;
      const Eigen::Matrix2d W = R.inverse();
      A += seen.by_pose.transpose() * W * seen.by_pose;
      g += seen.by_pose.transpose() * W * (Eigen::Vector2d(o.x_m, o.y_m) - seen.p_base);
      ++used;
    }
    if (used < 3) return false;
    const Eigen::Vector3d step = A.inverse() * g;
    if (!step.allFinite()) return false;
    at += step;
    if (step.norm() < 1e-6) break;
  }
  pose_.mean = at;
  pose_.mean.z() = wrapped_rad(at.z());
  pose_.covariance = A.inverse();
  return pose_.covariance.allFinite();
}

}  // namespace rigor::forest
