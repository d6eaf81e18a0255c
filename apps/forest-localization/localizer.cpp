#include "apps/forest-localization/localizer.h"

#include <algorithm>
#include <cmath>

namespace rigor::forest {
namespace {

constexpr Duration kNewRate = milliseconds(200);     ///< for so long the last rate stands for what comes
constexpr Duration kKeepAhead = milliseconds(1000);  ///< the filter follows at this distance without scans
constexpr Duration kHintLife = seconds(5);
constexpr std::uint32_t kFarHints = 3;

}  // namespace

Localizer::Localizer(const LocalizerConfig& config, const StemMap& map, std::optional<PoseGaussian> start)
    : config_(config),
      map_(&map),
      filter_(config.filter, map.size()),
      matcher_(config.matcher),
      relocalizer_(config.relocalizer) {
  if (!start) return;
  filter_.reset(*start);
  state_ = LocalizerState::tracking;
}

void Localizer::odometry(BenchTime t_capture, double way_m, double turn_rad) noexcept {
  if (!std::isfinite(way_m) || !std::isfinite(turn_rad)) return;
  if (odometry_.push(t_capture, {way_m, turn_rad}) && !begun_) {
    begun_ = true;
    t_filter_ = t_capture;
  }
}

void Localizer::gyro(BenchTime t_capture, double rate_radps) noexcept {
  if (!std::isfinite(rate_radps)) return;
  if (gyro_.size() == 0) {
    (void)gyro_.push(t_capture, {0});
  } else {
    const auto& last = gyro_.newest();
    const double dt_s = (t_capture - last.t).seconds();
    if (dt_s <= 0) return;
    if (dt_s > 0.5) gyro_.clear();  // a hole: what lies before is not known to this side of it
    (void)gyro_.push(t_capture,
                     {gyro_.size() == 0 ? 0.0 : last.sums[0] + 0.5 * (last_rate_radps_ + rate_radps) * dt_s});
  }
  last_rate_radps_ = rate_radps;
}

void Localizer::hint(BenchTime t_capture, const PositionHint& hint) noexcept {
  if (!std::isfinite(hint.x_m) || !std::isfinite(hint.y_m) || !(hint.sigma_m > 0)) return;
  t_hint_ = t_capture;
  hint_ = hint;
  if (state_ == LocalizerState::searching || !begun_) return;
  const PoseGaussian pose = at(t_capture);
  const double away = std::hypot(pose.mean.x() - hint.x_m, pose.mean.y() - hint.y_m);
  far_ = away > 5 * (hint.sigma_m + worst_sigma_m()) + 1 ? far_ + 1 : 0;
  if (far_ >= kFarHints) lose();
}

/// take(MotionIncrement) for each stretch between two instants over which all rates are even.
template <class F>
void Localizer::increments(BenchTime from, BenchTime to, F&& take) const noexcept {
  while (from < to) {
    MotionIncrement m;
    BenchTime end = to;
    const std::size_t next = odometry_.after(from);
    const bool told = odometry_.size() > 0 && from >= odometry_.oldest().t && next < odometry_.size();
    if (told) {
      end = std::min(to, odometry_[next].t);
      const auto a = odometry_.at(from), b = odometry_.at(end);
      m.way_m = b[0] - a[0];
      m.turn_rad = b[1] - a[1];
    } else if (odometry_.size() > 0 && from >= odometry_.newest().t) {
      const BenchTime silent_since = odometry_.newest().t;
      end = std::min(to, from + milliseconds(20));
      const double dt_s = (end - from).seconds(), since_s = (from - silent_since).seconds();
      const bool recent = from - silent_since < kNewRate;
      if (recent) {
        const auto rate = odometry_.rate();
        m.way_m = rate[0] * dt_s;
        m.turn_rad = rate[1] * dt_s;
      }
      // The unknown speed stays the same for a while: its sigma grows with the time, not with its root.
      const double grows = std::sqrt((since_s + dt_s) * (since_s + dt_s) - since_s * since_s);
      const double share = recent ? 0.3 : 1;
      m.extra_way_sigma_m = share * config_.guess_speed_mps * grows;
      m.extra_yaw_sigma_rad = share * config_.guess_turn_radps * grows;
    }
    if (odometry_.size() > 0 && from < odometry_.oldest().t) end = std::min(to, odometry_.oldest().t);
    m.dt_s = (end - from).seconds();
    // A gyro is asked where it covers the stretch; its last rate stands in for its latency.
    if (gyro_.size() > 1 && from >= gyro_.oldest().t && end <= gyro_.newest().t + milliseconds(50)) {
      double angle = gyro_.at(end)[0] - gyro_.at(from)[0];
      const BenchTime beyond = std::max(from, gyro_.newest().t);
      if (end > beyond) angle += last_rate_radps_ * (end - beyond).seconds();
      m.gyro_turn_rad = angle;
      m.extra_yaw_sigma_rad = 0;
    }
    take(m, told);
    from = end;
  }
}

void Localizer::advance(BenchTime to) noexcept {
  increments(t_filter_, to, [&](MotionIncrement m, bool told) {
    // A turn that was guessed must not teach the gyro: its variance says so without moving the yaw.
    if (!told && m.gyro_turn_rad) m.extra_yaw_sigma_rad = 1e-9;
    filter_.predict(m);
  });
  t_filter_ = std::max(t_filter_, to);
}

double Localizer::worst_sigma_m() const noexcept {
  const auto& P = filter_.covariance();
  const double half = (P(0, 0) + P(1, 1)) / 2, difference = (P(0, 0) - P(1, 1)) / 2;
  return std::sqrt(half + std::sqrt(difference * difference + P(0, 1) * P(0, 1)));
}

void Localizer::lose() noexcept {
  if (state_ != LocalizerState::searching) ++counters_.lost;
  state_ = LocalizerState::searching;
  poor_ = far_ = 0;
  relocalizer_.forget();
}

void Localizer::start_search(BenchTime t, std::span<const StemObservation> stems) noexcept {
  if (relocalizer_.state() == Relocalizer::State::working) return;
  std::optional<PositionHint> near;
  if (hint_ && t - t_hint_ < kHintLife) {
    near = hint_;
    near->sigma_m = std::hypot(near->sigma_m, config_.guess_speed_mps * (t - t_hint_).seconds());
  }
  ++counters_.searches;
  relocalizer_.begin(stems, *map_, near);
  t_search_ = t;
}

void Localizer::scan(BenchTime t_capture, std::span<const StemObservation> stems) noexcept {
  if (!begun_) {
    begun_ = true;
    t_filter_ = t_capture;
  }
  if (t_capture < t_filter_ && state_ != LocalizerState::searching) {
    ++counters_.old_scans;
    return;
  }
  ++counters_.scans;
  counters_.stems += stems.size();
  if (stems.empty()) ++counters_.empty_scans;
  if (state_ == LocalizerState::searching) {
    start_search(t_capture, stems);
    return;
  }
  advance(t_capture);

  const auto enough = [&](std::size_t matched) {
    return stems.size() < 3 ? matched > 0 : matched >= 2 && 10 * matched >= 4 * stems.size();
  };
  std::span<const StemMatch> matches = matcher_.match(stems, filter_.pose(), *map_);
  if (stems.size() >= 3 && !enough(matches.size())) {
    const std::size_t before = matches.size();
    PoseGaussian loose = filter_.pose();
    loose.covariance.diagonal() +=
        Eigen::Vector3d(config_.slip_m * config_.slip_m, config_.slip_m * config_.slip_m,
                        config_.slip_rad * config_.slip_rad);
    matches = matcher_.match(stems, loose, *map_);
    if (matches.size() >= 3 && matches.size() > before + 1 && 10 * matches.size() >= 6 * stems.size()) {
      filter_.loosen(config_.slip_m, config_.slip_rad);
      ++counters_.slips;
    } else {
      matches = matcher_.match(stems, filter_.pose(), *map_);
    }
  }
  counters_.matched += matches.size();
  (void)filter_.update(stems, matches, *map_);
  if (stems.size() >= 3) {
    poor_ = enough(matches.size()) ? 0 : poor_ + 1;
    if (poor_ > 0) ++counters_.poor_scans;
  }
  state_ = worst_sigma_m() < config_.lost_sigma_m ? LocalizerState::tracking : LocalizerState::dead_reckoning;
  if (poor_ >= config_.lost_scans) {
    lose();
    start_search(t_capture, stems);
  }
}

void Localizer::work(std::uint32_t poses) noexcept {
  if (state_ != LocalizerState::searching) return;
  relocalizer_.work(poses);
  if (relocalizer_.state() != Relocalizer::State::found) return;
  filter_.reset(relocalizer_.pose());
  relocalizer_.forget();
  t_filter_ = t_search_;
  state_ = LocalizerState::tracking;
  ++counters_.found;
  poor_ = config_.lost_scans / 2;  // the next scans must agree
}

PoseGaussian Localizer::at(BenchTime now) noexcept {
  if (!begun_) return filter_.pose();
  if (now - t_filter_ > kKeepAhead + kKeepAhead) {
    advance(now - kKeepAhead);
    if (state_ == LocalizerState::tracking && !(worst_sigma_m() < config_.lost_sigma_m))
      state_ = LocalizerState::dead_reckoning;
  }
  PoseFilter::State x = filter_.state();
  PoseFilter::Covariance P = filter_.covariance(), F;
  increments(t_filter_, now,
             [&](const MotionIncrement& m, bool) { PoseFilter::propagate(filter_.config(), m, x, P, F); });
  PoseGaussian out{x.head<3>(), P.topLeftCorner<3, 3>()};
  out.mean.z() = wrapped_rad(out.mean.z());
  return out;
}

double Localizer::speed_mps() const noexcept {
  return odometry_.rate()[0] * filter_.state()[PoseFilter::kWayScale];
}

double Localizer::turn_radps() const noexcept {
  if (gyro_.size() > 0) return last_rate_radps_ - filter_.state()[PoseFilter::kGyroBias];
  return odometry_.rate()[1] * filter_.state()[PoseFilter::kTurnScale];
}

}  // namespace rigor::forest
