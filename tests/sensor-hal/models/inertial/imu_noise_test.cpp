// What comes out of a simulated unit at rest, by its Allan deviation, against the sensor model's N, B and K.
#include <gtest/gtest.h>

#include <cmath>
#include <map>

#include "calibration/core/chi_squared.h"
#include "calibration/tof/allan.h"
#include "sensor-hal/models/imu/imu_model.h"
#include "tests/sensor-hal/models/inertial/statistics.h"

namespace rigor::models {
namespace {

using calibration::AllanPoint;
using calibration::overlapping_allan;
using test::expect_mean;
using test::expect_share;
using test::Mean;

constexpr int kSeeds = 100;
const Duration kPeriod = milliseconds(100);

/// The gyroscope's three series of one device.
std::array<std::vector<double>, 3> still(const ImuTriad& gyroscope, int seed, std::size_t n) {
  ImuModel model;
  model.gyroscope = gyroscope;
  ImuErrors errors(model, channel_key(static_cast<std::uint64_t>(seed), 1), kPeriod);
  std::array<std::vector<double>, 3> series;
  for (std::size_t i = 0; i < n; ++i) {
    const ImuSample s = errors.measure(i, 0, {0, 0, 9.81}, {});
    for (std::size_t axis = 0; axis < 3; ++axis) series[axis].push_back(s.angular_rate_radps[axis]);
  }
  return series;
}

/// Every τ of every series: means of the variance over what it should be, and how often that lay within the
/// 95 % limits of the estimator.
struct Found {
  std::map<std::size_t, Mean> over_truth;
  std::map<std::size_t, int> within;
  int series = 0;
};
template <class Truth>
Found look(const ImuTriad& gyroscope, std::size_t n, Truth&& variance) {
  Found f;
  for (int seed = 0; seed < kSeeds; ++seed)
    for (const auto& series : still(gyroscope, seed, n)) {
      ++f.series;
      for (const AllanPoint& p : overlapping_allan(series, kPeriod.seconds())) {
        const double truth = variance(p);
        f.over_truth[p.averaged].add(p.deviation * p.deviation / truth);
        f.within[p.averaged] += p.low * p.low <= truth && truth <= p.high * p.high;
      }
    }
  return f;
}

TEST(ImuNoise, WhiteNoiseHasItsDensity) {
  ImuTriad t;
  t.white = {2e-3, 2e-3, 2e-3};
  const Found f = look(t, 4000, [&](const AllanPoint& p) { return t.white[0] * t.white[0] / p.tau_s; });
  for (const auto& [m, mean] : f.over_truth) {
    if (m > 200) continue;  // few degrees of freedom: the mean of so skew a thing is no normal draw
    expect_mean(mean, 1, "variance over N²/τ");
    // The estimator's limits rest on the kind of noise that it finds: among fewer than 80 averages often
    // another one.
    if (4000 / m >= 80) expect_share(f.within.at(m), f.series, 0.95, "within the estimator's limits");
  }
}

TEST(ImuNoise, WhiteNoiseBehindAFilterHasTheSameDensityAndLessPower) {
  ImuTriad t;
  t.white = {2e-3, 2e-3, 2e-3};
  t.bandwidth_hz = 0.5;  // of 5 that half the rate is
  Mean power;
  const Found f = look(t, 4000, [&](const AllanPoint& p) { return t.white[0] * t.white[0] / p.tau_s; });
  EXPECT_LT(f.over_truth.at(1).mean(), 0.2);
  expect_mean(f.over_truth.at(200), 1 - 3 / (2 * 20 * 2 * M_PI * 0.5),
              "variance over N²/τ, less what the filter takes");
  for (int seed = 0; seed < kSeeds; ++seed)
    for (const auto& series : still(t, seed, 1)) power.add(series[0] * series[0]);
  const double a = std::exp(-2 * M_PI * 0.5 * 0.1);
  expect_mean(power, t.white[0] * t.white[0] / 0.1 * (1 - a) / (1 + a), "power");
}

TEST(ImuNoise, RandomWalkGrowsAsItShould) {
  ImuTriad t;
  t.random_walk = 1e-4;
  // Of a walk in steps: (2m² + 1)/(2m²) of K²τ/3.
  const Found f = look(t, 4000, [&](const AllanPoint& p) {
    const double m = static_cast<double>(p.averaged);
    return t.random_walk * t.random_walk * p.tau_s / 3 * (1 + 1 / (2 * m * m));
  });
  for (const auto& [m, mean] : f.over_truth) {
    if (m > 100) continue;
    expect_mean(mean, 1, "variance over K²τ/3");
    expect_share(f.within.at(m), f.series, 0.95, "within the estimator's limits");
  }
}

TEST(ImuNoise, InstabilityHasTheFloorThatBStatesAndTheCurveOfItsProcess) {
  ImuTriad t;
  t.instability = 3e-4;
  t.instability_time_s = 5;
  const Found f = look(t, 6000, [&](const AllanPoint& p) {
    return markov_variance(markov_sigma(t.instability), t.instability_time_s, p.tau_s);
  });
  for (const std::size_t m : {20u, 50u, 100u, 200u, 500u})
    expect_mean(f.over_truth.at(m), 1, "variance over that of the process");
  // The peak lies at 1.8926 T = 9.5 s, where it is flat: the variance at 10 s is that at the peak to 0.2 %.
  const double floor = 2 * std::log(2) / M_PI * t.instability * t.instability;
  const double at_10_s = markov_variance(markov_sigma(t.instability), 5.0, 10.0);
  EXPECT_NEAR(at_10_s / floor, 1, 2e-3);
}

TEST(ImuNoise, AllTermsTogetherGiveTheSumOfTheirVariances) {
  ImuTriad t;
  t.white = {2e-3, 2e-3, 2e-3};
  t.instability = 2e-3;
  t.instability_time_s = 5;
  t.random_walk = 2e-4;
  const AllanTerms<double> terms{t.white[0], t.instability, t.instability_time_s, t.random_walk};
  const Found f = look(t, 6000, [&](const AllanPoint& p) { return allan_variance(terms, p.tau_s); });
  int within = 0, all = 0;
  for (const std::size_t m : {5u, 10u, 20u, 50u, 100u, 200u, 500u}) {
    expect_mean(f.over_truth.at(m), 1, "variance over the sum");
    within += f.within.at(m), all += f.series;
  }
  // The degrees of freedom are those of the noise that dominates, so the coverage is near 95 %, not equal.
  EXPECT_GT(within, 0.92 * all);
  EXPECT_LT(within, 0.98 * all);
}

TEST(AllanTerms, ConvertAsDataSheetsThatStateBothDo) {
  // ADIS16470: 0.008 (°/s)/√Hz and 0.34 °/√h.
  EXPECT_NEAR(0.008 / std::sqrt(2) * 60, 0.34, 0.005);
  EXPECT_NEAR(kFloorOfInstability, std::sqrt(2 * std::log(2) / M_PI), 1e-6);
  double peak = 0;
  for (double tau = 1; tau < 3; tau += 1e-4) peak = std::max(peak, std::sqrt(markov_variance(1.0, 1.0, tau)));
  EXPECT_NEAR(kPeakOfMarkov, peak, 1e-6);
}

}  // namespace
}  // namespace rigor::models
