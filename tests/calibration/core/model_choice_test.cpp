#include "calibration/core/model_choice.h"

#include <ceres/autodiff_cost_function.h>
#include <gtest/gtest.h>

#include <cmath>
#include <iostream>
#include <limits>
#include <random>

#include "calibration/core/least_squares.h"

namespace rigor::calibration {
namespace {

constexpr double kNone = std::numeric_limits<double>::quiet_NaN();

Candidate candidate(const char* name, int parameters, double bic, std::vector<double> withheld) {
  Candidate c{.name = name, .parameters = parameters, .bic = bic};
  set_cross_validation(c, std::move(withheld));
  return c;
}

TEST(ModelChoice, TheSmallestModelThatNoOtherBeatsIsChosenAgainstTheBic) {
  // Views differ by far more than the models do: in pairs they tell that 2 is worse than 4, and not that 4 is
  // worse than 5.
  std::vector<Candidate> c{candidate("2", 2, 10, {30.5, 2.4, 10.6, 91.5}),
                           candidate("4", 4, 6, {30.1, 2.0, 10.1, 91.0}),
                           candidate("5", 5, 5, {30.0, 2.1, 10.0, 91.0})};
  EXPECT_EQ(choose_model(c), 1u);
  EXPECT_TRUE(c[1].chosen);
  EXPECT_FALSE(c[2].chosen);
  EXPECT_NE(c[2].note.find("least BIC"), std::string::npos) << c[2].note;
  EXPECT_NE(c[0].note.find("predicts worse than"), std::string::npos) << c[0].note;
  EXPECT_NEAR(paired_improvement(c[0], c[1]), 0.45 / 0.0289, 0.1);
}

TEST(ModelChoice, WhatPredictsBetterAtALargerBicIsNotChosen) {
  std::vector<Candidate> c{candidate("2", 2, 5, {1.5, 2.5, 3.5, 4.5}),
                           candidate("4", 4, 6, {1.4, 2.3, 3.4, 4.3})};
  EXPECT_EQ(choose_model(c), 0u);
  EXPECT_NE(c[1].note.find("best in cross-validation"), std::string::npos) << c[1].note;
}

TEST(ModelChoice, WithoutCrossValidationTheLeastBicDecides) {
  std::vector<Candidate> c{{.name = "a", .parameters = 1, .bic = 3, .cross_validation = kNone},
                           {.name = "b", .parameters = 2, .bic = 2, .cross_validation = kNone},
                           {.name = "c", .parameters = 3, .bic = 4, .cross_validation = kNone}};
  EXPECT_EQ(choose_model(c), 1u);
  EXPECT_NE(c[0].note.find("larger BIC than b"), std::string::npos) << c[0].note;
}

TEST(ModelChoice, PartsOfWhichAModelSaysNothingAreLeftOutOfThePairs) {
  Candidate a{}, b{};
  set_cross_validation(a, {4, kNone, 9, 16}, {1, 1, 2, 1});
  set_cross_validation(b, {3, 7, 7, kNone}, {1, 1, 2, 1});
  EXPECT_NEAR(a.cross_validation, std::sqrt((4 + 18 + 16) / 4.0), 1e-12);
  // Differences 1 and 2 of weights 1 and 2: mean 5/3, of standard error √(2·((2/3)² + (2/3)²))/3.
  EXPECT_NEAR(paired_improvement(a, b), (5.0 / 3) / (std::sqrt(2 * (8.0 / 9)) / 3), 1e-12);
  set_cross_validation(b, {3, kNone, kNone, kNone});
  EXPECT_TRUE(std::isnan(paired_improvement(a, b)));
}

/// y as a polynomial of `N` coefficients of x.
template <int N>
struct Curve {
  double x, y;
  template <class T>
  bool operator()(const T* p, T* r) const {
    T sum(0);
    for (int k = N - 1; k >= 0; --k) sum = sum * T(x) + p[k];
    r[0] = sum - y;
    return true;
  }
};
template <int N>
Result<LeastSquares::Outcome> fit_curve(const std::vector<double>& y, const std::vector<bool>& take,
                                        bool robust) {
  double p[N] = {};
  LeastSquares fit;
  fit.add_block(p, std::vector<ParameterInfo>(N));
  for (std::size_t i = 0; i < y.size(); ++i)
    if (take[i])
      fit.add(new ceres::AutoDiffCostFunction<Curve<N>, 1, N>(
                  new Curve<N>{2.0 * static_cast<double>(i) / static_cast<double>(y.size() - 1) - 1, y[i]}),
              {p}, static_cast<std::uint32_t>(i));
  return fit.solve({.robust = robust, .threads = 1});
}

/// Outliers are judged by the largest model, and all models are compared on the rest. That the rest fits the
/// largest model too well, and makes BIC choose it, is not so: it is chosen as often as where the outliers
/// are known.
TEST(ModelChoice, OutliersThatTheLargestModelJudgesDoNotFavourIt) {
  constexpr int kFits = 100;
  int by_judged = 0, by_known = 0;
  for (std::uint32_t seed = 0; seed < kFits; ++seed) {
    std::mt19937 random(seed);
    std::normal_distribution<double> noise(0, 0.1);
    std::uniform_real_distribution<double> unit(0, 1);
    std::vector<double> y;
    std::vector<bool> good, judged(60, true);
    for (int i = 0; i < 60; ++i) {
      good.push_back(unit(random) > 0.1);
      y.push_back(1 + 0.5 * i + noise(random) + (good.back() ? 0 : 3 * noise(random) * 3));
    }
    const auto largest = fit_curve<4>(y, std::vector<bool>(60, true), true);
    ASSERT_TRUE(largest) << largest.error().text();
    for (const auto id : largest->rejected_ids) judged[id] = false;
    const auto larger_is_chosen = [&](const std::vector<bool>& take) {
      const auto small = fit_curve<2>(y, take, false), large = fit_curve<4>(y, take, false);
      const auto n = static_cast<double>(small->residuals.size());
      return bic(2 * large->cost, n, 4) < bic(2 * small->cost, n, 2);
    };
    by_judged += larger_is_chosen(judged);
    by_known += larger_is_chosen(good);
  }
  std::cout << "larger model chosen: " << by_judged << " of " << kFits << ", with known outliers " << by_known
            << "\n";
  // By chance alone χ² of two degrees of freedom is beyond 2·ln 60 in 1.7 %: more than 6 of 100 at 0.0013.
  EXPECT_LE(by_judged, 6);
}

TEST(ModelChoice, BicPenalisesAParameterByTheLogarithmOfTheData) {
  EXPECT_NEAR(bic(100, 100, 3) - bic(100, 100, 2), std::log(100.0), 1e-12);
  EXPECT_NEAR(bic(200, 100, 2) - bic(100, 100, 2), 100 * std::log(2.0), 1e-9);
  EXPECT_TRUE(std::isfinite(bic(0, 10, 2)));
}

}  // namespace
}  // namespace rigor::calibration
