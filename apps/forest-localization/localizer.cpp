#include "apps/forest-localization/localizer.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace rigor::forest {
namespace {

constexpr Duration kNewRate = milliseconds(200);     ///< for so long the last rate stands for what comes
constexpr Duration kKeepAhead = milliseconds(1000);  ///< the filter follows at this distance without scans
constexpr Duration kHintLife = seconds(5);
constexpr std::uint32_t kFarHints = 3;
constexpr double kSeen_m = 0.05;        ///< how far a scanner sees a stem from where it is, sigma
constexpr double kAccident = 0.01;      ///< matches that accident brings less often speak for the pose
constexpr double kPlausible = 0.1;      ///< matches that accident brings more often teach the filter nothing
constexpr double kRareAccident = 1e-3;  ///< so rare that several scans of them end a search
constexpr std::uint32_t kAgreeingScans = 3;

/// P(N ≥ count) of a Poisson variable.
double poisson_tail(std::size_t count, double mean) noexcept {
  double term = std::exp(-mean), below = 0;
  for (std::size_t k = 0; k < count; ++k) {
    below += term;
    term *= mean / static_cast<double>(k + 1);
  }
  // For the small means in question, what is left of 1 keeps enough digits down to 1e-12.
  return std::max(1 - below, 0.0);
}

}  // namespace

Localizer::Localizer(const LocalizerConfig& config, const StemMap& map, std::optional<PoseGaussian> start)
    : config_(config),
      map_(&map),
      filter_(config.filter, map.size()),
      matcher_(config.matcher),
      relocalizer_(config.relocalizer) {
  if (!start) return;
  filter_.reset(*start);
  pose_known_ = true;
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
  poor_ = far_ = agreeing_ = 0;
  relocalizer_.forget();
}

void Localizer::start_search(BenchTime t, std::span<const StemObservation> stems) noexcept {
  if (relocalizer_.state() == Relocalizer::State::working) return;
  std::optional<PositionHint> near;
  if (hint_ && t - t_hint_ < kHintLife) {
    near = hint_;
    near->sigma_m = std::hypot(near->sigma_m, config_.guess_speed_mps * (t - t_hint_).seconds());
  }
  // Every other search looks only where dead reckoning says that the base is: among few poses fewer stems
  // convince.
  if (pose_known_ && counters_.searches % 2 == 0) {
    const Eigen::Vector3d here = filter_.pose().mean;
    const double sigma_m = std::max(3 * worst_sigma_m(), config_.near_m);
    if (!near || near->sigma_m > sigma_m) near = PositionHint{here.x(), here.y(), sigma_m};
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
  const bool lost = state_ == LocalizerState::searching;
  if (t_capture < t_filter_ && !lost) {
    ++counters_.old_scans;
    return;
  }
  ++counters_.scans;
  counters_.stems += stems.size();
  if (stems.empty()) ++counters_.empty_scans;
  if (lost) {
    start_search(t_capture, stems);
    if (!pose_known_ || t_capture < t_filter_) return;
  }
  advance(t_capture);

  // How many of K observations that stand anywhere fit by accident: as many as there are stems within reach
  // of each. The first two settle the pose; those after them have what is left of the reach.
  const auto expected = [&](double sigma_m) {
    const double reach_m = 3.7 * std::hypot(sigma_m, config_.filter.map_sigma_m, kSeen_m);
    return static_cast<double>(stems.size()) * map_->density_per_m2() * std::numbers::pi * reach_m * reach_m;
  };
  const double accidents = expected(worst_sigma_m()), settled = expected(0);
  const auto accident = [&](std::size_t matched) {
    const double all = poisson_tail(matched, accidents);
    if (matched < 3) return all;
    return std::min(all, std::max(accidents * accidents / 2, 1.0) * poisson_tail(matched - 2, settled));
  };
  std::span<const StemMatch> matches = matcher_.match(stems, filter_.pose(), *map_);
  if (lost) {
    // The pose may have been right all the time, and what was seen was not in the map.
    const bool agrees = matches.size() >= 3 && accident(matches.size()) < kRareAccident;
    agreeing_ = agrees ? agreeing_ + 1 : 0;
    if (agreeing_ < kAgreeingScans) return;
    relocalizer_.forget();
    state_ = LocalizerState::tracking;
    poor_ = 0;
    ++counters_.found;
  }
  // Most of what is seen fits, or more than accident brings.
  const auto most = [&](std::size_t matched, std::size_t tenths) {
    return matched >= 2 && 10 * matched >= tenths * stems.size();
  };
  if (stems.size() >= 3 && !most(matches.size(), 4) &&
      static_cast<double>(matches.size()) < 4 + 3 * accidents) {
    const std::size_t before = matches.size();
    PoseGaussian loose = filter_.pose();
    loose.covariance.diagonal() +=
        Eigen::Vector3d(config_.slip_m * config_.slip_m, config_.slip_m * config_.slip_m,
                        config_.slip_rad * config_.slip_rad);
    matches = matcher_.match(stems, loose, *map_);
    // With room for half a metre two may pair with anything near; the third leaves no more room.
    if (matches.size() > before + 1 &&
        ((matches.size() >= 3 && most(matches.size(), 6)) || matches.size() >= 6)) {
      filter_.loosen(config_.slip_m, config_.slip_rad);
      ++counters_.slips;
    } else {
      matches = matcher_.match(stems, filter_.pose(), *map_);
    }
  }
  counters_.matched += matches.size();
  // Among ferns and twigs that look like stems few of what is seen fit, at a right pose too: two or three
  // that accident does not bring are enough.
  const bool good = most(matches.size(), 4) || (matches.size() >= 2 && accident(matches.size()) < kAccident);
  if (good || stems.size() < 3 || accident(matches.size()) < kPlausible)
    (void)filter_.update(stems, matches, *map_);
  state_ = worst_sigma_m() < config_.lost_sigma_m ? LocalizerState::tracking : LocalizerState::dead_reckoning;
  if (stems.size() < 3) return;
  if (good) {
    poor_ = 0;
    way_good_m_ = way_m();
    relocalizer_.forget();
    return;
  }
  ++poor_;
  ++counters_.poor_scans;
  if (poor_ < config_.lost_scans) return;
  // In doubt: is there a better place? Where none is found, odometry carries it on for a while.
  if (std::abs(way_m() - way_good_m_) > config_.blind_way_m) lose();
  start_search(t_capture, stems);
}

void Localizer::work(std::uint32_t poses) noexcept {
  const bool lost = state_ == LocalizerState::searching;
  if (!lost && poor_ < config_.lost_scans) return;
  relocalizer_.work(poses);
  if (relocalizer_.state() != Relocalizer::State::found) return;
  if (!lost) ++counters_.lost;
  filter_.reset(relocalizer_.pose());
  relocalizer_.forget();
  t_filter_ = t_search_;
  state_ = LocalizerState::tracking;
  pose_known_ = true;
  way_good_m_ = way_m();
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
