#include "apps/forest-localization/pose_filter.h"

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>

namespace rigor::forest {
namespace {

Eigen::Matrix2d turned_by(double angle_rad) noexcept {
  const double c = std::cos(angle_rad), s = std::sin(angle_rad);
  Eigen::Matrix2d R;
  R << c, -s, s, c;
  return R;
}

}  // namespace

PoseFilter::PoseFilter(const PoseFilterConfig& config, std::size_t map_stems)
    : c_(config), cross_(map_stems, Cross::Zero()), active_(map_stems), is_active_(map_stems) {
  x_.setZero();
  x_[kWayScale] = x_[kTurnScale] = 1;
  P_.setZero();
  P_(kWayScale, kWayScale) = c_.way_scale_sigma * c_.way_scale_sigma;
  P_(kTurnScale, kTurnScale) = c_.turn_scale_sigma * c_.turn_scale_sigma;
  P_(kGyroBias, kGyroBias) = c_.gyro_bias_sigma_radps * c_.gyro_bias_sigma_radps;
  reset({});
}

void PoseFilter::reset(const PoseGaussian& pose) noexcept {
  x_.head<3>() = pose.mean;
  P_.topRows<3>().setZero();
  P_.leftCols<3>().setZero();
  P_.topLeftCorner<3, 3>() = pose.covariance;
  for (std::size_t i = 0; i < active_count_; ++i) {
    cross_[active_[i]].setZero();
    is_active_[active_[i]] = 0;
  }
  active_count_ = 0;
}

void PoseFilter::settle() noexcept {
  P_ = 0.5 * (P_ + P_.transpose().eval());
  x_[kYaw] = wrapped_rad(x_[kYaw]);
}

void PoseFilter::propagate(const PoseFilterConfig& config, const MotionIncrement& motion, State& x,
                           Covariance& P, Covariance& F) noexcept {
  const bool gyro = motion.gyro_turn_rad.has_value();
  const double way = x[kWayScale] * motion.way_m;
  const double turn =
      gyro ? *motion.gyro_turn_rad - x[kGyroBias] * motion.dt_s : x[kTurnScale] * motion.turn_rad;
  const double half = turn / 2, heading = x[kYaw] + half;
  const double sinc = std::abs(half) < 1e-4 ? 1 - half * half / 6 : std::sin(half) / half;
  const double c = std::cos(heading), s = std::sin(heading), chord = way * sinc;

  F.setIdentity();
  F(kX, kYaw) = -chord * s;
  F(kY, kYaw) = chord * c;
  F(kX, kWayScale) = motion.way_m * sinc * c;
  F(kY, kWayScale) = motion.way_m * sinc * s;
  const int by = gyro ? kGyroBias : kTurnScale;
  const double turn_by = gyro ? -motion.dt_s : motion.turn_rad;
  F(kYaw, by) = turn_by;
  F(kX, by) = -chord * s * turn_by / 2;  // the chord's length changes in second order only
  F(kY, by) = chord * c * turn_by / 2;

  const double length = std::abs(motion.way_m);
  const double keep_scale = std::exp(-length / config.scale_length_m);
  const double keep_bias = std::exp(-motion.dt_s / config.gyro_bias_time_s);
  x[kX] += chord * c;
  x[kY] += chord * s;
  x[kYaw] += turn;
  x[kWayScale] = 1 + (x[kWayScale] - 1) * keep_scale;
  x[kTurnScale] = 1 + (x[kTurnScale] - 1) * keep_scale;
  x[kGyroBias] *= keep_bias;
  F.row(kWayScale) *= keep_scale;
  F.row(kTurnScale) *= keep_scale;
  F.row(kGyroBias) *= keep_bias;

  P = (F * P * F.transpose()).eval();
  const auto sq = [](double v) { return v * v; };
  const double along2 = sq(config.along_per_sqrt_m) * length + sq(motion.extra_way_sigma_m);
  const double across2 = sq(config.across_per_sqrt_m) * length + sq(config.across_per_rad * turn) +
                         sq(motion.extra_way_sigma_m) / 4;
  const double told2 =
      sq(config.yaw_rad_per_sqrt_m) * length + sq(config.yaw_per_sqrt_rad) * std::abs(motion.turn_rad);
  const double yaw2 =
      (gyro ? sq(config.gyro_noise_rad_per_sqrt_s) * motion.dt_s : told2) + sq(motion.extra_yaw_sigma_rad);
  P(kX, kX) += along2 * c * c + across2 * s * s;
  P(kY, kY) += along2 * s * s + across2 * c * c;
  P(kX, kY) += (along2 - across2) * c * s;
  P(kY, kX) += (along2 - across2) * c * s;
  P(kYaw, kYaw) += yaw2;
  // Noise of the heading during the step moves its end by half of the chord.
  const double lever_x = -chord * s / 2, lever_y = chord * c / 2;
  P(kX, kYaw) += lever_x * yaw2, P(kYaw, kX) += lever_x * yaw2;
  P(kY, kYaw) += lever_y * yaw2, P(kYaw, kY) += lever_y * yaw2;
  P(kX, kX) += lever_x * lever_x * yaw2, P(kY, kY) += lever_y * lever_y * yaw2;
  P(kX, kY) += lever_x * lever_y * yaw2, P(kY, kX) += lever_x * lever_y * yaw2;
  P(kWayScale, kWayScale) += sq(config.way_scale_sigma) * (1 - sq(keep_scale));
  P(kTurnScale, kTurnScale) += sq(config.turn_scale_sigma) * (1 - sq(keep_scale));
  P(kGyroBias, kGyroBias) += sq(config.gyro_bias_sigma_radps) * (1 - sq(keep_bias));
}

void PoseFilter::predict(const MotionIncrement& motion) noexcept {
  Covariance F;
  propagate(c_, motion, x_, P_, F);
  for (std::size_t i = 0; i < active_count_; ++i) cross_[active_[i]] = F * cross_[active_[i]];
  if (motion.gyro_turn_rad && motion.extra_yaw_sigma_rad == 0)
    odometry_against_gyro(motion.turn_rad, *motion.gyro_turn_rad, motion.way_m, motion.dt_s);
  settle();
}

/// k·turn − (gyro_turn − b·dt) = 0, up to what the wheels' turn is good for.
void PoseFilter::odometry_against_gyro(double turn_rad, double gyro_turn_rad, double way_m,
                                       double dt_s) noexcept {
  State H = State::Zero();
  H[kTurnScale] = turn_rad;
  H[kGyroBias] = dt_s;
  const double residual = gyro_turn_rad - x_[kTurnScale] * turn_rad - x_[kGyroBias] * dt_s;
  const auto sq = [](double v) { return v * v; };
  double R = sq(c_.yaw_rad_per_sqrt_m) * std::abs(way_m) + sq(c_.yaw_per_sqrt_rad) * std::abs(turn_rad) +
             sq(c_.gyro_noise_rad_per_sqrt_s) * dt_s + sq(1e-4);
  const State PH = P_ * H;
  double S = H.dot(PH) + R;
  const double distance = std::abs(residual) / std::sqrt(S);
  if (distance > 6) return;  // wheels that slip tell nothing of the gyro
  if (distance > 2) R *= distance / 2, S = H.dot(PH) + R;
  const State K = PH / S;
  x_ += K * residual;
  P_ -= K * PH.transpose();
  for (std::size_t i = 0; i < active_count_; ++i) {
    Cross& cross = cross_[active_[i]];
    cross -= K * (H.transpose() * cross).eval();
  }
}

void PoseFilter::loosen(double position_sigma_m, double yaw_sigma_rad) noexcept {
  P_(kX, kX) += position_sigma_m * position_sigma_m;
  P_(kY, kY) += position_sigma_m * position_sigma_m;
  P_(kYaw, kYaw) += yaw_sigma_rad * yaw_sigma_rad;
}

UpdateReport PoseFilter::update(std::span<const StemObservation> stems, std::span<const StemMatch> matches,
                                const StemMap& map) noexcept {
  UpdateReport report;
  const std::size_t n = std::min(matches.size(), StemMatcher::kMaxMatches);
  report.matches = static_cast<std::uint32_t>(n);
  if (n == 0) return report;

  // The observed radius against the map's tells how far the centre lies behind the front that was seen:
  // conditioned on it, an observation is one of the centre alone.
  struct Centre {
    Eigen::Vector2d z;
    Eigen::Matrix2d R;
    double radius_distance = 0;
    double weight = 1;
  };
  std::array<Centre, StemMatcher::kMaxMatches> centre;
  const double map2 = c_.map_sigma_m * c_.map_sigma_m;
  for (std::size_t i = 0; i < n; ++i) {
    const StemObservation& o = stems[matches[i].observation];
    const double variance = o.covariance[2][2] + c_.map_radius_sigma_m * c_.map_radius_sigma_m;
    const Eigen::Vector2d with_radius(o.covariance[0][2], o.covariance[1][2]);
    const double difference = map[matches[i].stem].radius_m - o.radius_m;
    centre[i].z = Eigen::Vector2d(o.x_m, o.y_m) + with_radius * (difference / variance);
    centre[i].R << o.covariance[0][0], o.covariance[0][1], o.covariance[1][0], o.covariance[1][1];
    centre[i].R -= with_radius * with_radius.transpose() / variance;
    centre[i].radius_distance = difference * difference / variance;
  }

  // Where to linearise, and weights.
  const Eigen::Vector3d prior = x_.head<3>();
  const Eigen::Matrix3d prior_P = P_.topLeftCorner<3, 3>();
  const Eigen::Matrix3d prior_information = prior_P.inverse();
  Eigen::Vector3d at = prior;
  for (int iteration = 0; iteration < 6; ++iteration) {
    Eigen::Vector3d from_prior = at - prior;
    Eigen::Matrix3d A = prior_information;
    Eigen::Vector3d g = prior_information * from_prior;
    for (std::size_t i = 0; i < n; ++i) {
      const Stem& m = map[matches[i].stem];
      const SeenPoint seen = seen_from(at, m.x_m, m.y_m);
      const Eigen::Matrix2d total = centre[i].R + map2 * Eigen::Matrix2d::Identity();
      const Eigen::Vector2d e = centre[i].z - seen.p_base;
      if (iteration == 0) {
        const Eigen::Matrix2d S = total + seen.by_pose * prior_P * seen.by_pose.transpose();
        report.chi_squared += e.dot(S.inverse() * e) + centre[i].radius_distance;
      }
      const Eigen::Matrix2d W = total.inverse();
      const double distance = std::sqrt(e.dot(W * e) + centre[i].radius_distance);
      // The first step goes without weights: far from the answer all residuals are large.
      centre[i].weight = iteration == 0 || distance <= c_.huber ? 1 : c_.huber / distance;
      A.noalias() += centre[i].weight * seen.by_pose.transpose() * W * seen.by_pose;
      g.noalias() -= centre[i].weight * seen.by_pose.transpose() * W * e;
    }
    const Eigen::Vector3d step = -(A.inverse() * g);
    if (!step.allFinite()) break;
    at += step;
    if (iteration > 0 && step.norm() < 1e-7) break;
  }

  // Schmidt–Kalman, stem by stem, in the error ξ = (ρ, θ) of a motion of the plane about the prior's place o:
  // true pose = exp(ξ)·estimate. There a residual in the world, r = R·z + t − m, is −ρ − θ·J·(m − o) + the
  // map's error + noise: its derivative holds no estimate, and so no two updates disagree about which motions
  // a stem cannot tell.
  const Eigen::Vector2d o = prior.head<2>();
  for (std::size_t i = 0; i < n; ++i) {
    const std::uint32_t stem = matches[i].stem;
    if (centre[i].weight < 1) ++report.down_weighted;
    if (!is_active_[stem]) {
      is_active_[stem] = 1;
      active_[active_count_++] = stem;
    }
    const Eigen::Vector2d m(map[stem].x_m, map[stem].y_m);
    Eigen::Matrix<double, 2, kSize> H = Eigen::Matrix<double, 2, kSize>::Zero();
    H.leftCols<3>() << -1, 0, m.y() - o.y(), 0, -1, o.x() - m.x();
    const Eigen::Matrix2d R_at = turned_by(at.z());
    const Cross PHt = P_ * H.transpose() + cross_[stem];
    const Eigen::Matrix2d HC = H * cross_[stem];
    const Eigen::Matrix2d S = H * P_ * H.transpose() + HC + HC.transpose() +
                              map2 * Eigen::Matrix2d::Identity() +
                              R_at * centre[i].R * R_at.transpose() / centre[i].weight;
    const Cross K = PHt * S.inverse();
    const Eigen::Vector2d r = turned_by(x_[kYaw]) * centre[i].z + x_.head<2>() - m;
    for (std::size_t j = 0; j < active_count_; ++j) {
      Cross& cross = cross_[active_[j]];
      Eigen::Matrix2d seen_cross = H * cross;
      if (active_[j] == stem) seen_cross += map2 * Eigen::Matrix2d::Identity();
      cross -= K * seen_cross;
    }
    const State step = K * r;
    const double theta = step[kYaw], half = theta / 2;
    const double sinc = std::abs(half) < 1e-5 ? 1 - half * half / 6 : std::sin(half) / half;
    x_.head<2>() = o + turned_by(theta) * (x_.head<2>() - o) + sinc * turned_by(half) * step.head<2>();
    x_.tail<4>() += step.tail<4>();
    P_ -= K * PHt.transpose();
    settle();
  }
  // Back to errors of x, y and yaw.
  Covariance T = Covariance::Identity();
  T(kX, kYaw) = o.y() - x_[kY];
  T(kY, kYaw) = x_[kX] - o.x();
  P_ = (T * P_ * T.transpose()).eval();
  for (std::size_t j = 0; j < active_count_; ++j) cross_[active_[j]] = T * cross_[active_[j]];
  settle();
  return report;
}

}  // namespace rigor::forest
