// Mean and variance of what a converter that rounds gives, of Gaussian noise before it. EMVA 1288 adds 1/12
// DN², which fails below about 0.4 DN of noise; here is the rounding itself.
//
// With e(x) = round(x) − x = Σ (−1)^k sin(2πkx)/(πk) and noise of variance σ² about a mean f, each harmonic
// is damped by exp(−2π²k²σ²). The means f of a sensor's pixels differ: f ~ N(μ, τ²), which damps once more.
// Source: Widrow & Kollár, Quantization Noise (2008), ch. 4; probed against sampling in the tests.
#pragma once

#include <cmath>
#include <numbers>

namespace rigor::calibration {

/// `mean`: over pixels and time; `variance`: over time, averaged over the pixels. In steps of the converter.
template <class T>
void rounded_moments(const T& mean_in, const T& variance_in, double pixel_variance, T& mean, T& variance) {
  using std::cos;
  using std::exp;
  using std::sin;
  constexpr double kPi = std::numbers::pi;
  mean = mean_in;
  variance = variance_in + T(1.0 / 12);
  const T damp = T(-2 * kPi * kPi) * variance_in, spread = damp - T(2 * kPi * kPi * pixel_variance);
  for (int k = 1; k <= 24; ++k) {
    const T both = exp(spread * T(double(k) * k));
    const T own = exp(damp * T(double(k) * k));
    if (both < T(1e-9) && own * own < T(1e-9)) break;
    const double sign = k % 2 == 0 ? 1 : -1;
    const T c = cos(T(2 * kPi * k) * mean_in), s = sin(T(2 * kPi * k) * mean_in);
    mean += T(sign / (kPi * k)) * both * s;
    variance += both * c * (T(4 * sign) * variance_in + T(sign / (kPi * kPi * k * k)));
    // The square of the mean's error: products of harmonics k and l.
    for (int l = 1; l <= 24; ++l) {
      const T amplitude = own * exp(damp * T(double(l) * l));
      if (amplitude < T(1e-9)) break;
      const double sum = double(k + l), difference = double(k - l);
      const double tau = -2 * kPi * kPi * pixel_variance;
      const T product =
          T(0.5) * (T(std::exp(tau * difference * difference)) * cos(T(2 * kPi * difference) * mean_in) -
                    T(std::exp(tau * sum * sum)) * cos(T(2 * kPi * sum) * mean_in));
      variance -= T((l % 2 == 0 ? sign : -sign) / (kPi * kPi * k * l)) * amplitude * product;
    }
  }
}

/// Variance over pixels of their rounded means, of means that spread by τ² before.
/// `bent`: the part of it that is not the pattern itself.
inline double rounded_pixel_variance(double mean, double variance, double pixel_variance,
                                     double* bent = nullptr) {
  constexpr double kPi = std::numbers::pi;
  const double tau = -2 * kPi * kPi * pixel_variance, damp = -2 * kPi * kPi * variance;
  double slope = 0, shift = 0, square = 0;
  for (int k = 1; k <= 24; ++k) {
    const double own = std::exp(damp * k * k);
    if (own < 1e-9) break;
    const double sign = k % 2 == 0 ? 1 : -1, both = own * std::exp(tau * k * k);
    slope += 2 * sign * both * std::cos(2 * kPi * k * mean);
    shift += sign / (kPi * k) * both * std::sin(2 * kPi * k * mean);
    for (int l = 1; l <= 24; ++l) {
      const double amplitude = own * std::exp(damp * l * l);
      if (amplitude < 1e-9) break;
      square += (l % 2 == 0 ? sign : -sign) / (kPi * kPi * k * l) * amplitude * 0.5 *
                (std::exp(tau * (k - l) * (k - l)) * std::cos(2 * kPi * (k - l) * mean) -
                 std::exp(tau * (k + l) * (k + l)) * std::cos(2 * kPi * (k + l) * mean));
    }
  }
  if (bent) *bent = square - shift * shift;
  return pixel_variance * (1 + 2 * slope) + square - shift * shift;
}

/// τ² from what it is after rounding.
inline double pixel_variance_before(double mean, double variance, double rounded) {
  if (variance > 0.5 || rounded > 4) return rounded;
  double low = 0, high = 2 * rounded + 0.5;
  for (int i = 0; i < 60; ++i) {
    const double middle = 0.5 * (low + high);
    (rounded_pixel_variance(mean, variance, middle) < rounded ? low : high) = middle;
  }
  return 0.5 * (low + high);
}

}  // namespace rigor::calibration
