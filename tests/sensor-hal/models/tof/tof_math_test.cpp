// The time-of-flight pixel against closed forms: phases, wiggling, noise by Monte Carlo, over double and
// float.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <random>
#include <vector>

#include "sensor-hal/models/tof/tof_math.h"

namespace rigor::models {
namespace {

using M = TofMath<double>;
constexpr double kPi = std::numbers::pi;
constexpr double kLightSpeed_mps = 299792458.0;

struct Harmonics {
  double triangle = 0, a3 = 0, a5 = 0, a7 = 0, a9 = 0, bias = 1, variation = 1;
};
struct Phasor {
  double x = 0, y = 0;
};
Phasor phasor(double turns, const Harmonics& h) {
  Phasor p;
  M::tof_phasor(turns, h.triangle, h.a3, h.a5, h.a7, h.a9, h.bias, h.variation, p.x, p.y);
  return p;
}
/// Measured minus true phase, rad.
double phase_error(double turns, const Harmonics& h) {
  const Phasor p = phasor(turns, h);
  const double e = M::tof_angle_turns(p.x, p.y) - turns;
  return 2 * kPi * (e - std::floor(e + 0.5));
}

TEST(TofMath, SineAndCosineOfTurnsAreThoseOfTheLibrary) {
  for (int i = -4000; i <= 4000; ++i) {
    const double t = i / 797.0;
    double s = 0, c = 0;
    M::tof_sincos_turns(t, s, c);
    ASSERT_NEAR(s, std::sin(2 * kPi * t), 1e-10) << t;
    ASSERT_NEAR(c, std::cos(2 * kPi * t), 1e-10) << t;
    float sf = 0, cf = 0;
    TofMath<float>::tof_sincos_turns(static_cast<float>(t), sf, cf);
    // 2 pi times the rounding of t itself, and that of the series.
    const double tolerance = 2 * kPi * std::abs(t) * 6e-8 + 3e-7;
    ASSERT_NEAR(sf, s, tolerance) << t;
    ASSERT_NEAR(cf, c, tolerance) << t;
  }
}

/// B-spline of degree d with whole knots, by de Boor's recursion.
double b_spline(int i, int d, double t) {
  if (d == 0) return t >= i && t < i + 1 ? 1 : 0;
  return (t - i) / d * b_spline(i, d - 1, t) + (i + d + 1 - t) / d * b_spline(i + 1, d - 1, t);
}

TEST(TofMath, SplineIsTheOneOfDeBoorsRecursion) {
  for (double t = 0; t < 5; t += 0.037) {
    double first = 0, b[4];
    M::tof_spline(0.4 + 0.3 * t, 0.4, 1.9, 5, first, b[0], b[1], b[2], b[3]);
    const int at = static_cast<int>(first);
    ASSERT_GE(at, 0);
    ASSERT_LE(at, 4);
    for (int k = 0; k < 4; ++k) ASSERT_NEAR(b[k], b_spline(at + k - 3, 3, t), 1e-12) << t;
  }
  // Beyond its ends it stays, and no range takes it out of its coefficients.
  for (const double r : {-1e30, 0.4, 1.9, 2.0, 1e30, std::nan("")}) {
    double first = -1, b[4];
    M::tof_spline(r, 0.4, 1.9, 5, first, b[0], b[1], b[2], b[3]);
    EXPECT_EQ(first, r > 1 ? 4 : 0) << r;
    EXPECT_NEAR(b[0] + b[1] + b[2] + b[3], 1, 1e-12);
    EXPECT_NEAR(b[r > 1 ? 3 : 0], 1.0 / 6, 1e-12);
  }
}

TEST(TofMath, RangeErrorIsAnOffsetAndWhatGoesWithTheAmplitude) {
  EXPECT_DOUBLE_EQ(M::tof_range_error(0.02, 40, 8000), 0.025);
  EXPECT_EQ(M::tof_range_error(0.02, 0, 8000), 0.02);
  EXPECT_EQ(M::tof_range_error(0.02, 40, 0), 0.02);
}

TEST(TofMath, AngleIsTheLibrarysInAllQuadrantsAndOnTheAxes) {
  std::mt19937 random(1);
  std::normal_distribution<double> normal;
  for (int i = 0; i < 20000; ++i) {
    double x = normal(random), y = normal(random);
    if (i % 7 == 0) x = 0;
    if (i % 11 == 0) y = 0;
    if (i % 13 == 0) y = x;
    double expected = std::atan2(y, x) / (2 * kPi);
    if (expected < 0) expected += 1;
    const double got = M::tof_angle_turns(x, y);
    ASSERT_GE(got, 0.0);
    ASSERT_LT(got, 1.0);
    ASSERT_NEAR(got, expected, 1e-15) << x << ' ' << y;
    ASSERT_NEAR(TofMath<float>::tof_angle_turns(static_cast<float>(x), static_cast<float>(y)), got, 2e-7);
  }
  EXPECT_EQ(M::tof_angle_turns(0, 0), 0);
  EXPECT_EQ(M::tof_angle_turns(1, -1e-30), 0);  // not 1: a turn is [0, 1)
}

TEST(TofMath, FourTapsGiveBackPhaseAndAmplitude) {
  for (int i = 0; i < 360; ++i) {
    const double turns = i / 360.0, e = 1000 + i, contrast = 0.6;
    double s = 0, c = 0, d[4], back = 0, amplitude = 0;
    M::tof_sincos_turns(turns, s, c);
    M::tof_taps(e, e * c, e * s, contrast, 70, d[0], d[1], d[2], d[3]);
    for (int k = 0; k < 4; ++k)  // the definition
      EXPECT_NEAR(d[k], e / 2 * (1 + contrast * std::cos(2 * kPi * turns + k * kPi / 2)) + 70, 1e-6);
    M::tof_demodulate(d[0], d[1], d[2], d[3], back, amplitude);
    EXPECT_NEAR(std::remainder(back - turns, 1.0), 0, 1e-10);
    EXPECT_NEAR(amplitude, e * contrast / 2, 1e-6);
  }
}

/// Largest error of phase over one turn, and the number of its rises through zero: its periods.
std::pair<double, int> wiggling(const Harmonics& h) {
  double largest = 0;
  int rises = 0;
  const int n = 40000;
  for (int i = 0; i < n; ++i) {
    const double a = phase_error((i + 0.5) / n, h), b = phase_error((i + 1.5) / n, h);
    largest = std::max(largest, std::abs(a));
    if (a < 0 && b >= 0) ++rises;
  }
  return {largest, rises};
}

TEST(WigglingBias, OfHarmonicsOneAndThreeHasItsClosedFormAndFourPeriodsATurn) {
  for (const double a3 : {1.0 / 9, 0.05, -0.02}) {
    const Harmonics h{.a3 = a3};
    const auto [largest, periods] = wiggling(h);
    EXPECT_NEAR(largest, std::asin(std::abs(a3)), 1e-6);
    EXPECT_EQ(periods, 4);  // c/(8f) of c/(2f)
    for (const double t : {0.01, 0.2, 0.37, 0.71})
      EXPECT_NEAR(phase_error(t, h), std::atan2(-a3 * std::sin(8 * kPi * t), 1 + a3 * std::cos(8 * kPi * t)),
                  1e-9);
  }
  EXPECT_NEAR(wiggling({.a3 = 1.0 / 9}).first * 180 / kPi, 6.38, 0.005);
}

TEST(WigglingBias, OfSquareWavesIsFourDegrees113MillimetresAt30And68At50Megahertz) {
  const auto [largest, periods] = wiggling({.triangle = 1});
  EXPECT_NEAR(largest * 180 / kPi, 4.07, 0.005);
  EXPECT_EQ(periods, 4);
  const auto peak_to_peak_m = [&](double f) { return 2 * largest * kLightSpeed_mps / (4 * kPi * f); };
  EXPECT_NEAR(peak_to_peak_m(30e6), 0.113, 0.0005);
  EXPECT_NEAR(peak_to_peak_m(50e6), 0.068, 0.0005);
  // The same as the series' first four terms come to, up to its tail.
  const Harmonics series{.a3 = 1.0 / 9, .a5 = 1.0 / 25, .a7 = 1.0 / 49, .a9 = 1.0 / 81};
  for (const double t : {0.03, 0.18, 0.4, 0.66})
    EXPECT_NEAR(phase_error(t, series), phase_error(t, {.triangle = 1}), 0.02);
}

TEST(WigglingBias, SwitchedOffLeavesThePhaseAndKeepsTheAmplitudesChange) {
  for (int i = 0; i < 200; ++i) {
    const double t = i / 200.0;
    const Harmonics all{.triangle = 1};
    EXPECT_NEAR(phase_error(t, {.triangle = 1, .bias = 0}), 0, 1e-9);
    const Phasor whole = phasor(t, all), some = phasor(t, {.triangle = 1, .bias = 0}),
                 bias = phasor(t, {.triangle = 1, .variation = 0});
    EXPECT_NEAR(std::hypot(some.x, some.y), std::hypot(whole.x, whole.y), 1e-9);
    EXPECT_NEAR(std::hypot(bias.x, bias.y), 1, 1e-9);
    EXPECT_NEAR(phase_error(t, {.triangle = 1, .variation = 0}), phase_error(t, all), 1e-9);
  }
}

TEST(SineLikeNoise, AmplitudeOfSquareWavesVariesBetween1And0707FourTimesATurn) {
  double least = 1e9, most = 0;
  for (int i = 0; i < 8000; ++i) {
    const Phasor p = phasor(i / 8000.0, {.triangle = 1, .bias = 0});
    least = std::min(least, std::hypot(p.x, p.y));
    most = std::max(most, std::hypot(p.x, p.y));
    const Phasor later = phasor(i / 8000.0 + 0.25, {.triangle = 1, .bias = 0});
    ASSERT_NEAR(std::hypot(later.x, later.y), std::hypot(p.x, p.y), 1e-9);
  }
  EXPECT_NEAR(least / most, std::sqrt(0.5), 1e-6);
}

/// Ranges of `count` readings of a pixel: shot noise by the quantile, read noise, no well.
struct Readings {
  double mean_m = 0, sigma_m = 0, amplitude_e = 0, amplitude_sigma_e = 0;
};
Readings monte_carlo(double f, double turns, double e, double contrast, double background, double read,
                     const Harmonics& h, int count, unsigned seed) {
  const double turns_per_m = 2 * f / kLightSpeed_mps;
  const Phasor p = phasor(turns, h);
  double mean[4];
  M::tof_taps(e, e * p.x, e * p.y, contrast, background, mean[0], mean[1], mean[2], mean[3]);
  std::mt19937 random(seed);
  double sum = 0, squares = 0, a_sum = 0, a_squares = 0;
  for (int i = 0; i < count; ++i) {
    double d[4], saturated = 0, measured = 0, amplitude = 0;
    for (int k = 0; k < 4; ++k) {
      const double shot =
          M::poisson_quantile(mean[k], M::unit_from_bits(static_cast<std::uint32_t>(random())));
      const double draw = M::normal_quantile(M::unit_from_bits(static_cast<std::uint32_t>(random())));
      d[k] = M::tof_read_tap(shot, 0, 1e9, read, draw, 0, saturated);
    }
    M::tof_demodulate(d[0], d[1], d[2], d[3], measured, amplitude);
    const double off = std::remainder(measured - turns, 1.0) / turns_per_m;
    sum += off;
    squares += off * off;
    a_sum += amplitude;
    a_squares += amplitude * amplitude;
  }
  Readings r;
  r.mean_m = sum / count;
  r.sigma_m = std::sqrt(squares / count - r.mean_m * r.mean_m);
  r.amplitude_e = a_sum / count;
  r.amplitude_sigma_e = std::sqrt(a_squares / count - r.amplitude_e * r.amplitude_e);
  return r;
}

/// Relative half-width of what a sample standard deviation of n normal draws keeps to with 99.99 %.
double spread(int n) { return 3.9 / std::sqrt(2.0 * n); }

TEST(Trembling, RangeAndAmplitudeNoiseAreThoseOfTheFormula) {
  struct Case {
    double f, turns, e, contrast, background, read;
  };
  const int n = 40000;
  for (const Case& c : {Case{30e6, 0.13, 60000, 0.5, 0, 0}, Case{30e6, 0.9, 40000, 0.75, 100000, 0},
                        Case{50e6, 0.4, 20000, 0.6, 5000, 80}, Case{100e6, 0.62, 6000, 0.8, 2000, 30}}) {
    const Readings r = monte_carlo(c.f, c.turns, c.e, c.contrast, c.background, c.read, {}, n, 7);
    const double expected =
        M::tof_range_sigma(2 * c.f / kLightSpeed_mps, c.e / 2, c.background, c.read, c.contrast);
    // The formula is the first order: the next is (sigma of the phase)^2.
    const double phase = expected * 4 * kPi * c.f / kLightSpeed_mps;
    EXPECT_NEAR(r.sigma_m / expected, 1, spread(n) + phase * phase) << c.f;
    EXPECT_NEAR(r.mean_m, 0, 4 * expected / std::sqrt(double(n)) + 1e-6);
    // Amplitude: half of sqrt(x^2 + y^2), x and y each of variance 2 (A + B + read^2).
    const double a_sigma = std::sqrt((c.e / 2 + c.background + c.read * c.read) / 2);
    EXPECT_NEAR(r.amplitude_sigma_e / a_sigma, 1, spread(n) + phase * phase);
    EXPECT_NEAR(r.amplitude_e / (c.e * c.contrast / 2), 1,
                4 * a_sigma / r.amplitude_e / std::sqrt(double(n)) + phase * phase);
  }
}

TEST(Trembling, FormulaGives592MillimetresWhereTheMonteCarloOfTheLiteratureDoes) {
  // A pixel whose formula gives 5.92 mm: 30 MHz, contrast 0.5, no background.
  const double f = 30e6, contrast = 0.5;
  const double k = kLightSpeed_mps / (4 * kPi * f * std::sqrt(2.0));
  const double a = std::pow(k / (contrast * 5.92e-3), 2);
  EXPECT_NEAR(M::tof_range_sigma(2 * f / kLightSpeed_mps, a, 0, 0, contrast), 5.92e-3, 1e-9);
  const int n = 60000;
  EXPECT_NEAR(monte_carlo(f, 0.3, 2 * a, contrast, 0, 0, {}, n, 3).sigma_m, 5.92e-3,
              5.92e-3 * (spread(n) + 2e-4));
}

TEST(SineLikeNoise, SigmaGoesInverselyWithTheAmplitudeOverThePhase) {
  const int n = 30000;
  const Harmonics h{.triangle = 1, .bias = 0};
  const Readings strong = monte_carlo(30e6, 0.0, 50000, 0.6, 20000, 0, h, n, 5),
                 weak = monte_carlo(30e6, 0.125, 50000, 0.6, 20000, 0, h, n, 6),
                 strong_again = monte_carlo(30e6, 0.25, 50000, 0.6, 20000, 0, h, n, 8);
  EXPECT_NEAR(strong.sigma_m / weak.sigma_m, std::sqrt(0.5), std::sqrt(0.5) * 1.5 * spread(n));
  EXPECT_NEAR(strong.sigma_m / strong_again.sigma_m, 1, 1.5 * spread(n));
  // Switched off, none of it.
  const Harmonics off{.triangle = 1, .bias = 1, .variation = 0};
  EXPECT_NEAR(monte_carlo(30e6, 0.0, 50000, 0.6, 20000, 0, off, n, 5).sigma_m /
                  monte_carlo(30e6, 0.125, 50000, 0.6, 20000, 0, off, n, 6).sigma_m,
              1, 1.5 * spread(n));
}

TEST(TofTap, FillsItsWellAndSaysSo) {
  double saturated = 0;
  EXPECT_EQ(M::tof_read_tap(900, 0, 1000, 0, 0, 0, saturated), 900);
  EXPECT_EQ(saturated, 0);
  EXPECT_EQ(M::tof_read_tap(1000, 0, 1000, 0, 0, 0, saturated), 1000);
  EXPECT_EQ(saturated, 1);
  EXPECT_EQ(M::tof_read_tap(5000, 0, 1000, 0, 0, 0, saturated), 1000);
  EXPECT_EQ(saturated, 1);
  // What is drained does not fill it.
  EXPECT_EQ(M::tof_read_tap(5000, 4500, 1000, 0, 0, 0, saturated), 500);
  EXPECT_EQ(saturated, 0);
  EXPECT_EQ(M::tof_read_tap(13, 0, 1000, 0, 0, 10, saturated), 10);
  EXPECT_EQ(M::tof_read_tap(15, 0, 1000, 0, 0, 10, saturated), 20);
  EXPECT_EQ(M::tof_read_tap(0, 0, 1000, 8, -2, 10, saturated), -20) << "a pedestal keeps what is below zero";
}

TEST(TofTap, OnePhotonIsInOneTapOfFour) {
  // A mean of a quarter photon a tap: what is read are whole photons, on average that many.
  std::mt19937 random(2);
  double sum = 0;
  int ones = 0;
  const int n = 40000;
  for (int i = 0; i < n; ++i) {
    const double got = M::poisson_quantile(0.25, M::unit_from_bits(static_cast<std::uint32_t>(random())));
    EXPECT_EQ(got, std::floor(got));
    sum += got;
    ones += got == 1;
  }
  EXPECT_NEAR(sum / n, 0.25, 4 * 0.5 / std::sqrt(double(n)));
  EXPECT_NEAR(ones / double(n), 0.25 * std::exp(-0.25), 4 * 0.4 / std::sqrt(double(n)));
}

TEST(TofMath, NearestRangeOfAPhase) {
  const double per_m = 2 * 30e6 / kLightSpeed_mps;
  EXPECT_NEAR(M::tof_nearest_range(0.25, per_m, 0.1), 0.25 / per_m, 1e-12);
  EXPECT_NEAR(M::tof_nearest_range(0.25, per_m, 6.0), 1.25 / per_m, 1e-12);
  EXPECT_NEAR(M::tof_nearest_range(0.99, per_m, 0.0), -0.01 / per_m, 1e-12);
}

TEST(TofMath, FloatAgreesWithDouble) {
  std::mt19937 random(9);
  std::uniform_real_distribution<double> uniform;
  using F = TofMath<float>;
  for (int i = 0; i < 5000; ++i) {
    const auto turns = static_cast<float>(uniform(random) * 8);
    const auto a3 = static_cast<float>(0.1 * uniform(random)),
               a5 = static_cast<float>(0.05 * uniform(random));
    const float bias = i % 2 == 0, variation = i % 3 == 0, triangle = i % 5 == 0;
    float xf = 0, yf = 0;
    double x = 0, y = 0;
    F::tof_phasor(turns, triangle, a3, a5, 0, 0, bias, variation, xf, yf);
    M::tof_phasor(turns, triangle, a3, a5, 0, 0, bias, variation, x, y);
    // Eleven operations of the recurrences on values below 1.3.
    ASSERT_NEAR(xf, x, 3e-6);
    ASSERT_NEAR(yf, y, 3e-6);
    const auto e = static_cast<float>(1e5 * uniform(random));
    float df[4], tf = 0, af = 0;
    double d[4], t = 0, a = 0;
    F::tof_taps(e, e * xf, e * yf, 0.5F, 100.0F, df[0], df[1], df[2], df[3]);
    M::tof_taps(double(e), double(e) * x, double(e) * y, 0.5, 100, d[0], d[1], d[2], d[3]);
    for (int k = 0; k < 4; ++k) ASSERT_NEAR(df[k], d[k], 1e-5 * (double(e) + 100));
    F::tof_demodulate(df[0], df[1], df[2], df[3], tf, af);
    M::tof_demodulate(d[0], d[1], d[2], d[3], t, a);
    ASSERT_NEAR(std::remainder(double(tf) - t, 1.0), 0, 2e-6 + 1e-3 / (1 + double(e)));
    ASSERT_NEAR(af, a, 1e-5 * (double(e) + 100));
  }
}

}  // namespace
}  // namespace rigor::models
