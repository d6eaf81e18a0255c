#include "sensor-hal/channel/pair_watch/cusum.h"

#include <algorithm>
#include <cmath>

#include "sensor-hal/models/one_source.h"

namespace rigor::pair_watch {

double run_length_one_sided(double k, double h, double shift) {
  const double b = h + 1.166, delta = shift - k;
  if (std::abs(delta * b) < 1e-4) return b * b;  // the limit of no drift
  return (std::exp(-2 * delta * b) + 2 * delta * b - 1) / (2 * delta * delta);
}

double run_length_two_sided(double k, double h) { return run_length_one_sided(k, h) / 2; }

double threshold_for(double k, double run_length) {
  double low = 1, high = 1;
  if (run_length_two_sided(k, low) >= run_length) return low;
  while (run_length_two_sided(k, high) < run_length) high *= 2;
  for (int i = 0; i < 80; ++i) {
    const double middle = (low + high) / 2;
    (run_length_two_sided(k, middle) < run_length ? low : high) = middle;
  }
  return high;
}

double normal_quantile(double probability) {
  return models::NoiseMath<double>::normal_quantile(std::clamp(probability, 1e-10, 1 - 1e-10));
}

double chi_squared_quantile(double probability, double f) {
  const double a = 2 / (9 * f);
  const double root = 1 - a + normal_quantile(probability) * std::sqrt(a);
  return f * std::max(1e-6, root * root * root);
}

double student_quantile(double probability, double f) {
  const double z = normal_quantile(probability), z2 = z * z;
  return z * (1 + (z2 + 1) / (4 * f) + ((5 * z2 + 16) * z2 + 3) / (96 * f * f));
}

void Cusum::add(double z, std::uint64_t window) noexcept {
  if (!std::isfinite(z)) return;
  const double most = h_ / 2;
  const auto step = [&](double& sum, std::uint64_t& since, double x) {
    if (sum <= 0) since = window;
    sum = std::max(0.0, sum + std::min(x - k_, most));
  };
  step(up_, up_since_, z);
  step(down_, down_since_, -z);
}

void Cusum::restart(std::uint64_t window) noexcept {
  up_ = down_ = 0;
  up_since_ = down_since_ = window;
}

}  // namespace rigor::pair_watch
