// Mean and variance of what a converter that rounds gives, of Gaussian noise before it. EMVA 1288 adds 1/12
// DN², which fails below about 0.4 DN of noise; here is the rounding itself.
//
// With e(x) = round(x) − x = Σ (−1)^k sin(2πkx)/(πk), all that is needed of x is its characteristic function
// at u = 2πk. For x = f + K·Poisson(λ) − Kλ + Gaussian(g) it is
//
//   φ(u) = exp(i u f − u² g/2 + λ (exp(i u K) − 1 − i u K)),   E[(x − f) exp(i u x)] = φ (i u g + λ K (exp(i
//   u K) − 1))
//
// The Poisson's own is not a Gaussian's: few electrons of dark current move the mean by its skewness. The
// means f of a sensor's pixels differ: f ~ N(μ, τ²), which damps once more. Source: Widrow & Kollár,
// Quantization Noise (2008), ch. 4; probed against sampling in the tests.
#pragma once

#include <cmath>
#include <numbers>

namespace rigor::calibration {

inline constexpr int kRoundingHarmonics = 24;

/// `mean`: over pixels and time; `variance`: over time, averaged over the pixels. In steps of the converter.
/// Of the variance before it `gaussian`, and `gain · signal` of photo-electrons (signal 0: none).
template <class T>
void rounded_moments(const T& mean_in, const T& gaussian, const T& gain, const T& signal,
                     double pixel_variance, T& mean, T& variance) {
  using std::cos;
  using std::exp;
  using std::sin;
  constexpr double kPi = std::numbers::pi;
  mean = mean_in;
  variance = gaussian + gain * signal + T(1.0 / 12);
  T own[kRoundingHarmonics + 1], phase[kRoundingHarmonics + 1];
  int last = 0;
  const bool electrons = signal > T(0) && gain > T(0);
  for (int k = 1; k <= kRoundingHarmonics; ++k) {
    const double u = 2 * kPi * k;
    const T rest = exp(T(-0.5 * u * u) * gaussian);
    if (rest < T(1e-9)) break;  // a Poisson's comes back at K k = 1, 2, …
    own[k] = rest, phase[k] = T(u) * mean_in;
    last = k;
    T along = T(u) * gaussian, across = T(0);  // E[(x − f) exp(iux)]/φ = across + i along
    if (electrons) {
      const T number = signal / gain, half = sin(T(0.5 * u) * gain);
      own[k] = rest * exp(T(-2) * number * half * half);
      phase[k] += number * (sin(T(u) * gain) - T(u) * gain);
      along += signal * sin(T(u) * gain);
      across = T(-2) * signal * half * half;
    }
    if (own[k] < T(1e-9)) continue;
    const double sign = k % 2 == 0 ? 1 : -1;
    const T both = own[k] * T(std::exp(-0.5 * u * u * pixel_variance));
    const T c = cos(phase[k]), s = sin(phase[k]);
    mean += T(sign / (kPi * k)) * both * s;
    variance += T(sign / (kPi * k)) * both * (T(2) * (along * c + across * s) + T(1 / (kPi * k)) * c);
  }
  // The square of the mean's error: products of harmonics k and l.
  const double tau = -2 * kPi * kPi * pixel_variance;
  for (int k = 1; k <= last; ++k)
    for (int l = 1; l <= last; ++l) {
      const T amplitude = own[k] * own[l];
      if (amplitude < T(1e-9)) continue;
      const double sum = double(k + l), difference = double(k - l);
      const T product = T(0.5) * (T(std::exp(tau * difference * difference)) * cos(phase[k] - phase[l]) -
                                  T(std::exp(tau * sum * sum)) * cos(phase[k] + phase[l]));
      variance -= T(((k + l) % 2 == 0 ? 1 : -1) / (kPi * kPi * k * l)) * amplitude * product;
    }
}
/// The same of Gaussian noise alone.
template <class T>
void rounded_moments(const T& mean_in, const T& variance_in, double pixel_variance, T& mean, T& variance) {
  rounded_moments(mean_in, variance_in, T(0), T(0), pixel_variance, mean, variance);
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
