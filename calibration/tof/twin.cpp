#include "calibration/tof/twin.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "sensor-hal/models/philox.h"
#include "sensor-hal/models/tof/tof_math.h"

namespace rigor::calibration {
namespace {

using Math = models::TofMath<double>;

models::PhiloxKey key_of(std::uint64_t seed) {
  return models::channel_key(seed, models::channel_id_from_name("calibration twin"));
}
double normal(models::PhiloxKey key, models::NoiseEffect effect, std::size_t i, std::size_t word) {
  return Math::normal_quantile(
      Math::unit_from_bits(models::draw_words(key, effect, i >> 32, static_cast<std::uint32_t>(i))[word]));
}

}  // namespace

std::vector<double> twin_of_pixel(const std::vector<NoiseSample>& samples, const PixelNoise& pixel,
                                  const models::TofModel& model, std::uint64_t seed) {
  const auto key = key_of(seed);
  std::vector<double> out;
  const auto& f = model.modulation.frequencies_hz;
  for (std::size_t i = 0; i < samples.size(); ++i) {
    const double a = samples[i].amplitude * pixel.electrons;
    if (!(a > 0)) continue;
    const double e = 2 * a / pixel.contrast;
    double sum = 0, weights = 0;
    for (std::size_t j = 0; j < f.size(); ++j) {
      const auto at = [&](models::NoiseEffect first) {
        return models::draw_words(key, static_cast<models::NoiseEffect>(static_cast<std::size_t>(first) + j),
                                  i >> 32, static_cast<std::uint32_t>(i));
      };
      const auto shot = at(models::NoiseEffect::tof_shot), read = at(models::NoiseEffect::tof_read);
      const double phase = Math::unit_from_bits(
          models::draw_words(key, models::NoiseEffect::tof_jitter, 0, static_cast<std::uint32_t>(i))[j % 4]);
      double s = 0, c = 1, d[4], full = 0, turns = 0, amplitude = 0;
      Math::tof_sincos_turns(phase, s, c);
      Math::tof_taps(e, e * c, e * s, pixel.contrast, 0, d[0], d[1], d[2], d[3]);
      for (std::size_t k = 0; k < 4; ++k)
        d[k] = Math::tof_read_tap(Math::poisson_quantile(d[k], Math::unit_from_bits(shot[k])), 0, 1e300,
                                  pixel.read_noise_e, Math::normal_quantile(Math::unit_from_bits(read[k])), 0,
                                  full);
      Math::tof_demodulate(d[0], d[1], d[2], d[3], turns, amplitude);
      const double error = turns - phase, turns_per_m = 2 * f[j] / 299792458.0;
      sum += turns_per_m * (error - std::round(error));
      weights += turns_per_m * turns_per_m;
    }
    out.push_back(sum / weights + pixel.floor_m * normal(key, models::NoiseEffect::tof_fixed_pattern, i, 0));
  }
  return out;
}

std::vector<double> twin_of_law(const std::vector<NoiseSample>& samples, const NoiseCoefficients& law,
                                std::uint64_t seed) {
  const auto key = key_of(seed);
  std::vector<double> out;
  for (std::size_t i = 0; i < samples.size(); ++i)
    out.push_back(law.sigma_m(samples[i].amplitude) * normal(key, models::NoiseEffect::tof_shot, i, 0));
  return out;
}

std::vector<double> twin_of_series(const DriftFit& fit, std::size_t count, std::uint64_t seed) {
  const auto key = key_of(seed);
  std::vector<double> out;
  const double phi = fit.correlation_s > 0 ? std::exp(-fit.period_s / fit.correlation_s) : 0;
  double walk = 0, slow = 0;
  for (std::size_t i = 0; i < count; ++i) {
    const auto words =
        models::draw_words(key, models::NoiseEffect::tof_shot, i >> 32, static_cast<std::uint32_t>(i));
    const auto draw = [&](std::size_t k) { return Math::normal_quantile(Math::unit_from_bits(words[k])); };
    if (i > 0) walk += fit.random_walk * std::sqrt(fit.period_s) * draw(1);
    slow = i == 0 ? fit.correlated_m * draw(2)
                  : phi * slow + fit.correlated_m * std::sqrt(1 - phi * phi) * draw(2);
    const double t = (static_cast<double>(i) - 0.5 * static_cast<double>(count)) * fit.period_s;
    // The rounding's own noise is in the white noise that was fitted: it is added again below.
    const double white = std::sqrt(std::max(0.0, fit.white_m * fit.white_m - fit.step_m * fit.step_m / 12));
    const double value = fit.mean_m + fit.drift_mps * t + walk + slow + white * draw(0);
    out.push_back(fit.step_m > 0 ? fit.step_m * std::round(value / fit.step_m) : value);
  }
  return out;
}

std::array<double, kTwinQuantiles.size()> quantiles_of(std::vector<double> values) {
  std::array<double, kTwinQuantiles.size()> out{};
  out.fill(std::numeric_limits<double>::quiet_NaN());
  std::erase_if(values, [](double v) { return !std::isfinite(v); });
  if (values.empty()) return out;
  std::sort(values.begin(), values.end());
  for (std::size_t i = 0; i < out.size(); ++i)
    out[i] = values[static_cast<std::size_t>(kTwinQuantiles[i] * static_cast<double>(values.size() - 1))];
  return out;
}

}  // namespace rigor::calibration
