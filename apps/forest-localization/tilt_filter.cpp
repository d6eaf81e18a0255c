#include "apps/forest-localization/tilt_filter.h"

#include <algorithm>
#include <cmath>

namespace rigor::forest {
namespace {
constexpr double kSpeedOver_s = 0.2;  ///< speed is the way over this: encoders count steps
}

StemObservation levelled(const StemObservation& stem, double height_m, const Tilt& tilt) noexcept {
  const double cr = std::cos(tilt.roll_rad), sr = std::sin(tilt.roll_rad);
  const double cp = std::cos(tilt.pitch_rad), sp = std::sin(tilt.pitch_rad);
  StemObservation out = stem;
  out.x_m = cp * stem.x_m + sp * (sr * stem.y_m + cr * height_m);
  out.y_m = cr * stem.y_m - sr * height_m;
  return out;  // its covariance changes by a few parts in a thousand
}

void TiltFilter::Axis::predict(double rate_radps, double dt_s, double noise) noexcept {
  angle_rad += (rate_radps - bias_radps) * dt_s;
  p_angle += dt_s * (dt_s * p_bias - 2 * p_cross) + noise * dt_s;
  p_cross -= dt_s * p_bias;
  p_bias += 1e-10 * dt_s;  // it walks a little
}

void TiltFilter::Axis::update(double measured_rad, double variance) noexcept {
  const double s = p_angle + variance, k0 = p_angle / s, k1 = p_cross / s;
  const double innovation = measured_rad - angle_rad;
  angle_rad += k0 * innovation;
  bias_radps += k1 * innovation;
  p_bias -= k1 * p_cross;
  p_cross -= k0 * p_cross;
  p_angle -= k0 * p_angle;
}

void TiltFilter::odometry(BenchTime t, double way_m) noexcept {
  if (!way_.push(t, {way_m})) return;
  const BenchTime before = t - seconds_from(kSpeedOver_s);
  if (!way_.covers(before)) return;
  const double speed = (way_m - way_.at(before)[0]) / kSpeedOver_s;
  const double dt_s = (t - t_speed_).seconds();
  if (dt_s > 0 && dt_s < 1) {
    const double share = std::min(1.0, dt_s / kSpeedOver_s);
    acceleration_mps2_ += share * ((speed - speed_mps_) / dt_s - acceleration_mps2_);
  }
  speed_mps_ = speed;
  t_speed_ = t;
}

void TiltFilter::imu(BenchTime t, const std::array<double, 3>& f, const std::array<double, 3>& w) noexcept {
  if (begun_ && t <= t_imu_) return;
  const double ax = acceleration_mps2_, ay = speed_mps_ * w[2], g = config_.gravity_mps2;
  const double pitch = std::asin(std::clamp((ax - f[0]) / g, -0.9, 0.9));
  const double roll = std::atan2(f[1] - ay, std::max(f[2], 0.1 * g));
  const double dt_s = begun_ ? (t - t_imu_).seconds() : 0;
  if (!begun_ || dt_s > 1) {
    for (Axis* axis : {&roll_, &pitch_}) {
      axis->p_angle = config_.start_sigma_rad * config_.start_sigma_rad;
      axis->p_cross = 0;
      if (!begun_) axis->p_bias = config_.bias_sigma_radps * config_.bias_sigma_radps;
    }
    begun_ = true;
  } else {
    const double sr = std::sin(roll_.angle_rad), cr = std::cos(roll_.angle_rad);
    const double tp = std::tan(std::clamp(pitch_.angle_rad, -1.2, 1.2));
    roll_.predict(w[0] + tp * (sr * w[1] + cr * w[2]), dt_s, config_.rate_noise_rad2_per_s);
    pitch_.predict(cr * w[1] - sr * w[2], dt_s, config_.rate_noise_rad2_per_s);
  }
  t_imu_ = t;
  const double variance = config_.gravity_noise_rad2_s / std::clamp(dt_s, 1e-3, 0.1);
  roll_.update(roll, variance);
  pitch_.update(pitch, variance);
  (void)angles_.push(t, {roll_.angle_rad, pitch_.angle_rad});
}

Tilt TiltFilter::at(BenchTime t) const noexcept {
  if (angles_.size() == 0) return {};
  const auto sums = angles_.at(t);
  return {sums[0], sums[1]};
}

}  // namespace rigor::forest
