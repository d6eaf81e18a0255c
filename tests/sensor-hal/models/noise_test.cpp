#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <vector>

#include "sensor-hal/models/one_source.h"
#include "sensor-hal/models/philox.h"

namespace rigor::models {
namespace {

using D = NoiseMath<double>;
using F = NoiseMath<float>;

TEST(Draws, UniformIsOpenSymmetricAndEqualInFloatAndDouble) {
  EXPECT_GT(D::unit_from_bits(0), 0.0);
  EXPECT_LT(D::unit_from_bits(~0u), 1.0);
  EXPECT_EQ(D::unit_from_bits(0) + D::unit_from_bits(~0u), 1.0);
  for (std::uint32_t i = 0; i < 100000; ++i) {
    const std::uint32_t bits = i * 2654435761u;
    ASSERT_EQ(static_cast<double>(F::unit_from_bits(bits)), D::unit_from_bits(bits));
  }
}

TEST(Draws, NormalQuantileInvertsTheDistributionFunction) {
  for (double u = 1.0 / (1 << 24); u < 1.0; u += 1e-4) {
    const double z = D::normal_quantile(u);
    const double u_back = 0.5 * std::erfc(-z / std::numbers::sqrt2);
    // AS 241, PPND7: 1e-7 relative in z; into u by the density.
    const double density = std::exp(-0.5 * z * z) / std::sqrt(2 * std::numbers::pi);
    EXPECT_NEAR(u_back, u, 3e-7 * (std::abs(z) + 1e-3) * density + 1e-15) << u;
  }
}

double poisson_cdf(double mean, int k) {
  if (k < 0) return 0.0;
  double term = std::exp(-mean), sum = term;
  for (int i = 1; i <= k; ++i) sum += term *= mean / i;
  return sum;
}

// The quantile of u is k exactly where CDF(k - 1) < u <= CDF(k). Integrated over u, the share of draws that
// the expansion misplaces is sum |CDF_model - CDF|, found by bisection of the quantile in u.
TEST(Draws, PoissonQuantileIsThatOfThePoissonDistribution) {
  for (const double mean : {0.0, 0.01, 0.7, 3.0, 9.99, 10.0, 12.5, 30.0, 100.0, 400.0}) {
    double misplaced = 0.0;
    const int top = static_cast<int>(mean + 8 * std::sqrt(mean) + 12);
    for (int k = 0; k < top; ++k) {
      double low = 1e-9, high = 1.0 - 1e-9;
      if (D::poisson_quantile(mean, low) > k) {
        misplaced += poisson_cdf(mean, k);
        continue;
      }
      if (D::poisson_quantile(mean, high) <= k) continue;
      for (int i = 0; i < 50; ++i)
        (D::poisson_quantile(mean, 0.5 * (low + high)) <= k ? low : high) = 0.5 * (low + high);
      misplaced += std::abs(low - poisson_cdf(mean, k));
    }
    EXPECT_LT(misplaced, mean < 10.0 ? 1e-6 : 2e-3) << "mean " << mean;
  }
}

struct Moments {
  double mean = 0, variance = 0;
};
Moments flat_field(double mean_e, double read_e, double gain, double black, std::uint32_t n,
                   double max_dn = 65535) {
  const PhiloxKey key = channel_key(7, channel_id_from_name("flat"));
  double sum = 0, sum2 = 0;
  for (std::uint32_t i = 0; i < n; ++i) {
    const auto w = draw_words(key, NoiseEffect::camera_shot_and_read, 3, i);
    const double e = D::emva_collected_electrons(D::poisson_quantile(mean_e, D::unit_from_bits(w[0])), 1e9,
                                                 0.0, read_e, D::normal_quantile(D::unit_from_bits(w[1])));
    const double y = D::emva_quantise(D::emva_analogue_dn(e, gain, black), max_dn);
    sum += y;
    sum2 += y * y;
  }
  const double mean = sum / n;
  return {mean, (sum2 - n * mean * mean) / (n - 1)};
}

// EMVA 1288: var_y = K^2 var_d + 1/12 + K (mu_y - mu_dark). The sample variance of n nearly normal draws has
// the relative standard deviation sqrt((2 + kurtosis) / n); 4 sigma of it (chi-squared in its normal limit),
// excess kurtosis of a Poisson 1/mean. Seen to fail with the Giles terms of order 1 dropped (bias of the
// mean) and with K in place of K^2.
TEST(EmvaNoise, FlatFieldHasTheMeanAndVarianceOfEmva1288) {
  constexpr std::uint32_t n = 400000;
  for (const double mean_e : {0.5, 4.0, 9.5, 10.5, 25.0, 300.0, 8000.0})
    for (const double gain : {0.5, 2.0}) {
      const double read_e = 6.0, black = 100.0;
      const Moments dark = flat_field(0.0, read_e, gain, black, n);
      const Moments m = flat_field(mean_e, read_e, gain, black, n);
      const double expected = gain * gain * read_e * read_e + 1.0 / 12.0 + gain * (gain * mean_e);
      EXPECT_NEAR(m.mean - dark.mean, gain * mean_e, 4 * std::sqrt((m.variance + dark.variance) / n))
          << mean_e;
      EXPECT_NEAR(m.variance / expected, 1.0, 4 * std::sqrt((2.0 + 1.0 / mean_e) / n))
          << mean_e << " K " << gain;
    }
}

TEST(EmvaNoise, SaturatesAtTheWellAndAtTheConverter) {
  EXPECT_EQ(D::emva_collected_electrons(20000, 10000, 0, 0, 0), 10000);
  EXPECT_EQ(D::emva_quantise(300.4, 255), 255);
  EXPECT_EQ(D::emva_quantise(-3.0, 255), 0);
  EXPECT_EQ(D::emva_quantise(10.5, 255), 11);
  EXPECT_EQ(D::emva_mean_electrons(-5.0, 1.0, 1.0, 1.0), 0.0);
}

// Float against double: same draws, same counts but where the quantile lies within float's error of a step.
// That error is about 1e-6 of the standard deviation plus 6e-8 of the mean, so below 1e-3 of the draws at
// 20000 e-.
TEST(EmvaNoise, FloatFollowsDouble) {
  int different = 0;
  constexpr int n = 100000;
  const PhiloxKey key = channel_key(1, 2);
  for (int i = 0; i < n; ++i) {
    const auto w = draw_words(key, NoiseEffect::camera_shot_and_read, 0, static_cast<std::uint32_t>(i));
    const float mean = static_cast<float>(20000.0 * F::unit_from_bits(w[2]));
    const double kd = D::poisson_quantile(mean, D::unit_from_bits(w[0]));
    const float kf = F::poisson_quantile(mean, F::unit_from_bits(w[0]));
    EXPECT_NEAR(kf, kd, 1.0);
    different += kf != kd ? 1 : 0;
    EXPECT_NEAR(F::normal_quantile(F::unit_from_bits(w[1])), D::normal_quantile(D::unit_from_bits(w[1])),
                4e-6);
  }
  EXPECT_LT(different, n / 200);
}

}  // namespace
}  // namespace rigor::models
