// Estimating equations whose uncertainty is the scatter of places and of stretches of time, and how far their
// steps are taken.
#include <gtest/gtest.h>

#include <Eigen/Dense>

#include "calibration/core/chi_squared.h"
#include "calibration/pair/clustered_fit.h"
#include "tests/sensor-hal/pair_watch/noise_for_tests.h"

namespace rigor::calibration {
namespace {

using pair_watch::testing::Random;

TEST(ClusteredFit, HuberWeightsLeaveUncertaintiesAsLargeAsTheErrors) {
  constexpr int kSeeds = 600;
  const std::vector<double> one{1};
  double squares = 0;
  for (int seed = 0; seed < kSeeds; ++seed) {
    Random random(std::uint64_t(seed) + 1);
    ClusteredFit fit(1, 20);
    std::vector<double> measured(20 * 40);
    for (double& m : measured) m = random.normal();
    double mean = 0;
    ClusteredFit::Solution solution;
    for (int pass = 0; pass < 8; ++pass) {
      fit.clear();
      for (std::size_t i = 0; i < measured.size(); ++i) {
        const double r = measured[i] - mean;
        fit.add(i % 20, one, one, r, huber_weight(1, std::abs(r) / 1.345));
        if (i % 20 == 19) fit.end_stretch();
      }
      solution = fit.solve({false});
      mean += solution.step[0];
    }
    squares += mean * mean / solution.covariance(0, 0);
  }
  std::printf("  chi-squared %.1f of %d\n", squares, kSeeds);
  // Few clusters, of which the larger of two estimates is taken: somewhat cautious.
  EXPECT_LT(squares, chi_squared_quantile(0.9995, kSeeds));
  EXPECT_GT(squares, 0.6 * kSeeds);
}

TEST(ClusteredFit, WhatOutliersAloneSayIsNotDetermined) {
  ClusteredFit fit(2, 8);
  Random random(1);
  for (std::size_t i = 0; i < 320; ++i) {
    const bool second = i % 4 == 0;
    const std::vector<double> j{second ? 0.0 : 1.0, second ? 1.0 : 0.0};
    const double r = second ? 50 + random.normal() : random.normal();
    fit.add(i / 4 % 8, j, j, r, huber_weight(1, std::abs(r) / 1.345));
    if (i % 32 == 31) fit.end_stretch();
  }
  const auto solution = fit.solve({false, false});
  EXPECT_TRUE(solution.determined[0]);
  EXPECT_FALSE(solution.determined[1]);
  EXPECT_TRUE(std::isinf(solution.covariance(1, 1)));
  EXPECT_GT(solution.covariance(0, 0), 0);
}

/// Places tell nothing of a disturbance that all of them have at the same time.
TEST(ClusteredFit, UncertaintiesHoldADisturbanceOfAllPlacesAtATime) {
  constexpr std::size_t kPlaces = 20, kStretches = 60;
  constexpr int kSeeds = 300;
  double squares = 0, level_squares = 0;
  for (int seed = 0; seed < kSeeds; ++seed) {
    Random random(std::uint64_t(seed) + 1);
    ClusteredFit fit(2, kPlaces);
    for (std::size_t k = 0; k < kStretches; ++k) {
      const double of_all = random.normal();
      for (std::size_t p = 0; p < kPlaces; ++p) {
        const std::array<double, 2> j{1, double(p) / (kPlaces - 1) - 0.5};
        fit.add(p, j, j, of_all + random.normal(), {1, 1});
      }
      fit.end_stretch();
    }
    const auto solution = fit.solve({false, false});
    squares += solution.step.dot(solution.covariance.ldlt().solve(solution.step));
    level_squares += solution.step[0] * solution.step[0] / solution.covariance(0, 0);
  }
  std::printf("  chi-squared %.1f of %d, of the level %.1f of %d\n", squares, 2 * kSeeds, level_squares,
              kSeeds);
  EXPECT_LT(squares, chi_squared_quantile(0.9995, 2 * kSeeds));
  // Of what places tell of, the larger of two estimates is taken: somewhat cautious.
  EXPECT_GT(squares, 0.6 * 2 * kSeeds);
  EXPECT_LT(level_squares, chi_squared_quantile(0.9995, kSeeds));
  EXPECT_GT(level_squares, chi_squared_quantile(0.0005, kSeeds));
}

TEST(ClusteredFit, AConditionDoesNotMakeUpForAParameterWithoutData) {
  ClusteredFit fit(4, 8);
  const std::array<double, 4> sum{0, 1, 1, 1};
  fit.constrain(sum);
  Random random(1);
  for (std::size_t i = 0; i < 320; ++i) {
    const bool second = i % 2 == 0;
    const std::array<double, 4> j{1, second ? 0.0 : 1.0, second ? 1.0 : 0.0, 0};
    fit.add(i / 4 % 8, j, j, 5 + (second ? 1 : -1) + 0.1 * random.normal(), {1, 1});
    if (i % 32 == 31) fit.end_stretch();
  }
  const auto solution = fit.solve({false, false, false, false});
  EXPECT_TRUE(std::isinf(solution.covariance(3, 3)));
  for (const auto& [k, truth] : {std::pair{0, 5.0}, {1, -1.0}, {2, 1.0}}) {
    EXPECT_TRUE(solution.determined[std::size_t(k)]) << k;
    EXPECT_NEAR(solution.step[k], truth, 4 * std::sqrt(solution.covariance(k, k))) << k;
  }
}

/// A column that is noise, with an instrument of other noise: the scatter of such an estimate says little.
TEST(ClusteredFit, AColumnOfNoiseAloneIsNotDetermined) {
  for (std::uint64_t seed = 0; seed < 50; ++seed) {
    ClusteredFit fit(2, 20);
    Random random(seed + 1);
    for (std::size_t i = 0; i < 4000; ++i) {
      const double x = random.normal();
      // What the column has of the other one does not make it known.
      const std::array<double, 2> j{x, x + random.normal()}, z{x, x + random.normal()};
      fit.add(i % 20, z, j, x + random.normal(), {1, 1});
      if (i % 100 == 99) fit.end_stretch();
    }
    const auto solution = fit.solve({false, false});
    EXPECT_TRUE(std::isinf(solution.covariance(1, 1))) << seed;
    EXPECT_NEAR(solution.step[0], 1, 4.5 * std::sqrt(solution.covariance(0, 0))) << seed;
  }
}

TEST(Relaxation, StepsThatOvershootTwiceEndAtOnce) {
  // A slope of half its size: x goes to -x for ever.
  double x = 1;
  Relaxation relaxation;
  for (int pass = 0; pass < 3; ++pass) x += relaxation.next(Eigen::VectorXd::Constant(1, -2 * x)) * -2 * x;
  EXPECT_NEAR(x, 0, 1e-12);
  // What converges by itself is left alone.
  x = 1;
  Relaxation whole;
  for (int pass = 0; pass < 10; ++pass) {
    const double factor = whole.next(Eigen::VectorXd::Constant(1, -0.5 * x));
    EXPECT_EQ(factor, 1);
    x += factor * -0.5 * x;
  }
}

}  // namespace
}  // namespace rigor::calibration
