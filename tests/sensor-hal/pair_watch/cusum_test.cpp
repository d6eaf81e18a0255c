#include "sensor-hal/channel/pair_watch/cusum.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "tests/sensor-hal/pair_watch/noise_for_tests.h"

namespace rigor::pair_watch {
namespace {

using testing::Random;

struct RunLength {
  double mean, sigma;
};
/// Without the limit on a single number, which the formula does not know.
RunLength simulated(double k, double h, double shift, bool both_sides, int runs, std::uint64_t seed) {
  Random random(seed);
  double sum = 0, squares = 0;
  for (int r = 0; r < runs; ++r) {
    double up = 0, down = 0, n = 0;
    while (up < h && (!both_sides || down < h)) {
      const double z = random.normal() + shift;
      up = std::max(0.0, up + z - k), down = std::max(0.0, down - z - k);
      ++n;
    }
    sum += n, squares += n * n;
  }
  const double mean = sum / runs;
  return {mean, std::sqrt((squares / runs - mean * mean) / runs)};
}

TEST(Cusum, RunLengthsAreThoseOfSimulation) {
  // Siegmund's approximation is good to some 3 % here; four sigmas of the simulation on top of that.
  struct Case {
    double k, h, shift;
    bool both;
  };
  for (const Case c :
       {Case{0.5, 4, 0, true}, Case{0.5, 5, 0, true}, Case{0.25, 8, 0, true}, Case{0.75, 3, 0, true},
        Case{0.5, 4, 0.5, false}, Case{0.5, 5, 1, false}, Case{0.5, 8, 2, false}}) {
    const RunLength s = simulated(c.k, c.h, c.shift, c.both, 4000, 7);
    const double formula = c.both ? run_length_two_sided(c.k, c.h) : run_length_one_sided(c.k, c.h, c.shift);
    EXPECT_NEAR(formula, s.mean, 0.03 * s.mean + 4 * s.sigma)
        << "k " << c.k << " h " << c.h << " shift " << c.shift;
  }
}

TEST(Cusum, LargeReferenceValuesRunNoShorterWithTheThresholdOfOne) {
  const double h = threshold_for(1, 800);
  for (const double k : {1.0, 1.5}) {
    const RunLength s = simulated(k, h, 0, true, 2000, 11);
    EXPECT_GT(s.mean + 4 * s.sigma, 0.97 * 800) << k;
  }
}

TEST(Cusum, ThresholdIsTheInverseOfTheRunLength) {
  for (const double k : {0.25, 0.5, 1.0})
    for (const double n : {1e2, 1e4, 1e7})
      EXPECT_NEAR(run_length_two_sided(k, threshold_for(k, n)) / n, 1, 1e-6);
  EXPECT_EQ(threshold_for(0.5, 1), 1);  // never less than one standard deviation
}

TEST(Cusum, QuantilesAreThoseOfTables) {
  EXPECT_NEAR(normal_quantile(0.975), 1.959964, 1e-5);
  EXPECT_NEAR(normal_quantile(1e-4), -3.719016, 1e-5);
  EXPECT_NEAR(student_quantile(0.975, 20), 2.08596, 2e-3);
  EXPECT_NEAR(student_quantile(0.999, 15), 3.7328, 2e-2);
  EXPECT_NEAR(chi_squared_quantile(0.95, 10), 18.307, 0.05);
  EXPECT_NEAR(chi_squared_quantile(0.01, 20), 8.260, 0.05);
  EXPECT_NEAR(chi_squared_quantile(0.001, 50), 24.674, 0.1);
}

TEST(Cusum, KnowsSinceWhenASumGrows) {
  Cusum sum(0.5, 6);
  for (std::uint64_t w = 0; w < 10; ++w) sum.add(0, w);
  for (std::uint64_t w = 10; w < 13; ++w) sum.add(-2, w);
  EXPECT_FALSE(sum.alarm());
  sum.add(-2, 13);
  EXPECT_TRUE(sum.alarm());
  EXPECT_EQ(sum.since(), 10u);
}

TEST(Cusum, OneDisturbedNumberIsNoAlarmTwoAre) {
  Cusum sum(0.5, 8);
  sum.add(1e9, 0);
  EXPECT_FALSE(sum.alarm());
  sum.add(std::numeric_limits<double>::quiet_NaN(), 1);
  sum.add(std::numeric_limits<double>::infinity(), 1);
  EXPECT_FALSE(sum.alarm());
  sum.add(1e9, 2);
  EXPECT_TRUE(sum.alarm());
}

}  // namespace
}  // namespace rigor::pair_watch
