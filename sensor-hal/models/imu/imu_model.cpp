#include "sensor-hal/models/imu/imu_model.h"

#include <algorithm>
#include <cmath>

namespace rigor::models {
namespace {

// Streams of draws: the accelerometer's and the gyroscope's.
constexpr std::uint32_t kAccelerometer = 0, kGyroscope = 1;

Status check(const ImuTriad& t, const std::string& name) {
  const auto bad = [&](const char* field, const char* expected, double got) {
    return fail(ErrorCode::bad_input, name + "." + field,
                std::string("expected ") + expected + ", got " + std::to_string(got));
  };
  for (const auto& [field, value] : {std::pair{"bias_sigma", t.bias_sigma},
                                     {"bias_per_k_sigma", t.bias_per_k_sigma},
                                     {"scale_sigma", t.scale_sigma},
                                     {"misalignment_sigma", t.misalignment_sigma},
                                     {"g_sensitivity_sigma", t.g_sensitivity_sigma},
                                     {"white", std::min({t.white[0], t.white[1], t.white[2]})},
                                     {"instability", t.instability},
                                     {"random_walk", t.random_walk},
                                     {"bandwidth", t.bandwidth_hz},
                                     {"range", t.range},
                                     {"resolution", t.resolution}})
    if (!(value >= 0) || !std::isfinite(value)) return bad(field, "a number that is not negative", value);
  if (!(t.instability_time_s > 0) || !std::isfinite(t.instability_time_s))
    return bad("instability_time", "a time above zero", t.instability_time_s);
  return {};
}

}  // namespace

Status check(const ImuModel& m) {
  if (auto s = check(m.accelerometer, "accelerometer"); !s) return s;
  if (auto s = check(m.gyroscope, "gyroscope"); !s) return s;
  if (!(m.warm_up_time_s > 0))
    return fail(ErrorCode::bad_input, "temperature.warm_up_time",
                "expected a time above zero, got " + std::to_string(m.warm_up_time_s));
  return {};
}

ImuModel draw_device(ImuModel model, PhiloxKey key) {
  // Elements: triad · 16 + which group of three.
  const auto add = [&](double* values, std::size_t count, double sigma, std::uint32_t first) {
    for (std::size_t i = 0; i < count; ++i)
      values[i] += sigma * normal_draws(key, NoiseEffect::imu_device, 0,
                                        first + static_cast<std::uint32_t>(i / 3))[i % 3];
  };
  std::uint32_t element = 0;
  for (ImuTriad* t : {&model.accelerometer, &model.gyroscope}) {
    add(t->bias.data(), 3, t->bias_sigma, element);
    add(t->bias_per_k.data(), 3, t->bias_per_k_sigma, element + 1);
    add(t->scale.data(), 3, t->scale_sigma, element + 2);
    add(t->misalignment.data(), 6, t->misalignment_sigma, element + 3);
    add(t->g_sensitivity.data(), 9, t->g_sensitivity_sigma, element + 5);
    t->bias_sigma = t->bias_per_k_sigma = t->scale_sigma = t->misalignment_sigma = 0;
    t->g_sensitivity_sigma = 0;
    element += 16;
  }
  return model;
}

ImuErrors::ImuErrors(const ImuModel& model, PhiloxKey key, Duration period)
    : device_(draw_device(model, key)),
      key_(key),
      accelerometer_(noise_of(device_.accelerometer, key, kAccelerometer, period.seconds())),
      gyroscope_(noise_of(device_.gyroscope, key, kGyroscope, period.seconds())) {}

ImuErrors::Noise ImuErrors::noise_of(const ImuTriad& t, PhiloxKey key, std::uint32_t stream,
                                     double period_s) const {
  Noise n;
  // A sample is the mean over its period: σ² = N²/Δt. Behind a filter that is narrower than half the rate
  // neighbours are correlated by a = e^(−2π·f·Δt); the density at f = 0 stays N² with σ² = N²/Δt·(1 − a)/(1 +
  // a).
  double share = 1;
  if (t.bandwidth_hz > 0 && t.bandwidth_hz < 0.5 / period_s) {
    const double captures = 1 / (2 * std::numbers::pi * t.bandwidth_hz * period_s),
                 a = std::exp(-1 / captures);
    share = (1 - a) / (1 + a);
    n.white = MarkovPath::stationary(key, NoiseEffect::imu_white, stream, captures);
    n.white_is_path = true;
  }
  for (std::size_t i = 0; i < 3; ++i) n.white_sigma[i] = t.white[i] * std::sqrt(share / period_s);
  if (t.instability > 0) {
    n.instability =
        MarkovPath::stationary(key, NoiseEffect::imu_instability, stream, t.instability_time_s / period_s);
    n.instability_sigma = markov_sigma(t.instability);
  }
  if (t.random_walk > 0) {
    n.walk = MarkovPath::walk(key, NoiseEffect::imu_walk, stream);
    n.walk_sigma = t.random_walk * std::sqrt(period_s);
  }
  return n;
}

double ImuErrors::temperature_c(double since_start_s) const noexcept {
  return device_.ambient_c +
         device_.warm_up_k * (1 - std::exp(-std::max(0.0, since_start_s) / device_.warm_up_time_s));
}

void ImuErrors::add_noise(std::array<double, 3>& y, const ImuTriad& t, Noise& noise, std::uint64_t index,
                          std::uint32_t stream) const noexcept {
  const auto white =
      noise.white_is_path ? noise.white.at(index) : normal_draws(key_, NoiseEffect::imu_white, index, stream);
  const auto slow = noise.instability.at(index), walk = noise.walk.at(index);
  for (std::size_t i = 0; i < 3; ++i) {
    y[i] += noise.white_sigma[i] * white[i] + noise.instability_sigma * slow[i] + noise.walk_sigma * walk[i];
    if (t.range > 0) y[i] = std::clamp(y[i], -t.range, t.range);
    if (t.resolution > 0) y[i] = std::round(y[i] / t.resolution) * t.resolution;
  }
}

ImuSample ImuErrors::measure(std::uint64_t index, double since_start_s,
                             const std::array<double, 3>& specific_force_mps2,
                             const std::array<double, 3>& angular_rate_radps) noexcept {
  const double warm_c = temperature_c(since_start_s), above_25_k = warm_c - 25;
  ImuSample s;
  s.specific_force_mps2 =
      triad_response(device_.accelerometer, specific_force_mps2, specific_force_mps2, above_25_k);
  s.angular_rate_radps =
      triad_response(device_.gyroscope, angular_rate_radps, specific_force_mps2, above_25_k);
  add_noise(s.specific_force_mps2, device_.accelerometer, accelerometer_, index, kAccelerometer);
  add_noise(s.angular_rate_radps, device_.gyroscope, gyroscope_, index, kGyroscope);
  if (device_.tells_temperature) {
    const double step = device_.temperature_resolution_k;
    s.temperature_c = step > 0 ? std::round(warm_c / step) * step : warm_c;
  }
  return s;
}

}  // namespace rigor::models
