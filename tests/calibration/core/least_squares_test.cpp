#include "calibration/core/least_squares.h"

#include <ceres/autodiff_cost_function.h>
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <random>

#include "calibration/core/chi_squared.h"

namespace rigor::calibration {
namespace {

/// y = a + b·x
struct Line {
  double x, y;
  template <class T>
  bool operator()(const T* p, T* r) const {
    r[0] = p[0] + p[1] * x - y;
    return true;
  }
};
ceres::CostFunction* line(double x, double y) {
  return new ceres::AutoDiffCostFunction<Line, 1, 2>(new Line{x, y});
}

struct Points {
  std::vector<double> x, y;
};
Points noisy_line(std::uint32_t seed, int n, double a, double b, double sigma) {
  std::mt19937 random(seed);
  std::normal_distribution<double> noise(0, sigma);
  Points p;
  for (int i = 0; i < n; ++i) {
    p.x.push_back(i * 0.1);
    p.y.push_back(a + b * p.x.back() + noise(random));
  }
  return p;
}

TEST(LeastSquares, ALineHasTheCovarianceOfTheNormalEquations) {
  const Points p = noisy_line(1, 50, 2, -0.5, 0.1);
  double v[2] = {0, 0};
  LeastSquares fit;
  fit.add_block(v, {{"a"}, {"b"}});
  for (std::size_t i = 0; i < p.x.size(); ++i)
    fit.add(line(p.x[i], p.y[i]), {v}, static_cast<std::uint32_t>(i));
  const auto out = fit.solve({.robust = false, .unit = "m"});
  ASSERT_TRUE(out) << out.error().text();
  double n = 0, sx = 0, sxx = 0, sy = 0, sxy = 0;
  for (std::size_t i = 0; i < p.x.size(); ++i) {
    n += 1, sx += p.x[i], sxx += p.x[i] * p.x[i], sy += p.y[i], sxy += p.x[i] * p.y[i];
  }
  const double det = n * sxx - sx * sx;
  EXPECT_NEAR(v[1], (n * sxy - sx * sy) / det, 1e-9);
  EXPECT_NEAR(v[0], (sxx * sy - sx * sxy) / det, 1e-9);
  double ssr = 0;
  for (std::size_t i = 0; i < p.x.size(); ++i) ssr += std::pow(v[0] + v[1] * p.x[i] - p.y[i], 2);
  const double s2 = ssr / (n - 2);
  EXPECT_NEAR(out->fit.covariance(0, 0), s2 * sxx / det, 1e-9);
  EXPECT_NEAR(out->fit.covariance(0, 1), -s2 * sx / det, 1e-9);
  EXPECT_NEAR(out->fit.find("b")->sigma, std::sqrt(s2 * n / det), 1e-9);
  EXPECT_TRUE(out->fit.weak.empty());
  EXPECT_EQ(out->fit.residuals.count, 50u);
}

TEST(LeastSquares, OutliersAreNamedAndDoNotMoveTheLine) {
  Points p = noisy_line(2, 100, 1, 2, 0.01);
  for (std::size_t i = 0; i < 30; ++i) p.y[i * 3] += 5 + 0.1 * static_cast<double>(i);
  double v[2] = {0, 0};
  LeastSquares fit;
  fit.add_block(v, {{"a"}, {"b"}});
  for (std::size_t i = 0; i < p.x.size(); ++i)
    fit.add(line(p.x[i], p.y[i]), {v}, static_cast<std::uint32_t>(i));
  const auto out = fit.solve({});
  ASSERT_TRUE(out);
  EXPECT_NEAR(v[0], 1, 0.02);
  EXPECT_NEAR(v[1], 2, 0.005);
  ASSERT_EQ(out->rejected_ids.size(), 30u);
  for (const auto id : out->rejected_ids) EXPECT_EQ(id % 3, 0u);
  EXPECT_GT(out->fit.rejected[0].residual, out->fit.rejected[29].residual);
  EXPECT_NEAR(out->fit.scale, 0.01, 0.002);
}

/// y = (a + b)·x: only the sum is seen.
struct Sum {
  double x, y;
  template <class T>
  bool operator()(const T* p, T* r) const {
    r[0] = (p[0] + p[1]) * x - y;
    return true;
  }
};

TEST(LeastSquares, WhatTheDataCannotTellApartIsNamedAndHasNoUncertainty) {
  double v[2] = {1, 0};
  LeastSquares fit;
  fit.add_block(v, {{"gain"}, {"offset"}});
  for (int i = 1; i <= 20; ++i)
    fit.add(new ceres::AutoDiffCostFunction<Sum, 1, 2>(new Sum{i * 1.0, i * 2.0 + 0.01 * (i % 3)}), {v}, 0);
  const auto out = fit.solve({.robust = false});
  ASSERT_TRUE(out);
  ASSERT_EQ(out->fit.weak.size(), 1u);
  EXPECT_TRUE(std::isinf(out->fit.weak[0].sigma) || out->fit.weak[0].sigma > 1e3);
  ASSERT_EQ(out->fit.weak[0].parts.size(), 2u);
  EXPECT_NEAR(out->fit.weak[0].parts[0].weight * out->fit.weak[0].parts[1].weight, -1, 1e-6);
  EXPECT_NE(out->fit.weak[0].words.find("cannot tell apart"), std::string::npos);
  EXPECT_TRUE(std::isinf(out->fit.find("gain")->sigma));
}

/// Lines that share a slope; each has an offset of its own.
struct Shared {
  double x, y;
  template <class T>
  bool operator()(const T* slope, const T* offset, T* r) const {
    r[0] = offset[0] + slope[0] * x - y;
    return true;
  }
};

TEST(LeastSquares, EliminatedBlocksGiveTheCovarianceOfTheWholeProblem) {
  std::mt19937 random(3);
  std::normal_distribution<double> noise(0, 0.1);
  double slope = 0, offset[4] = {0, 0, 0, 0};
  LeastSquares fit;
  fit.add_block(&slope, {{"slope"}});
  for (double& o : offset) fit.add_nuisance(&o, 1);
  Eigen::MatrixXd j(40, 5);
  j.setZero();
  int row = 0;
  for (int k = 0; k < 4; ++k)
    for (int i = 0; i < 10; ++i, ++row) {
      const double x = i + 3 * k;
      fit.add(new ceres::AutoDiffCostFunction<Shared, 1, 1, 1>(new Shared{x, k + 0.7 * x + noise(random)}),
              {&slope, &offset[k]}, 0);
      j(row, 0) = x;
      j(row, 1 + k) = 1;
    }
  fit.want_nuisance_covariance = true;
  const auto out = fit.solve({.robust = false});
  ASSERT_TRUE(out);
  const Eigen::MatrixXd whole = (j.transpose() * j).inverse() * out->fit.scale * out->fit.scale;
  EXPECT_NEAR(out->fit.covariance(0, 0), whole(0, 0), 1e-12);
  ASSERT_EQ(out->nuisance_covariance.size(), 4u);
  EXPECT_NEAR(out->nuisance_covariance[2](0, 0), whole(3, 3), 1e-10);
}

/// A polynomial of degree 7 over −1 … 1: eight unknowns.
struct Polynomial {
  double x, y;
  template <class T>
  bool operator()(const T* p, T* r) const {
    T sum(0);
    for (int k = 7; k >= 0; --k) sum = sum * T(x) + p[k];
    r[0] = sum - y;
    return true;
  }
};

/// Twenty measurements of eight unknowns: the first robust fit passes through eight of them nearly, and a
/// scale from the median of all is so small that good ones are rejected and stay rejected.
TEST(LeastSquares, FewMeasurementsOfManyUnknownsAreNotRejectedAndTheirCovarianceHolds) {
  constexpr int kFits = 100, kUnknowns = 8, kMeasurements = 20;
  double sum = 0;
  std::size_t rejected = 0;
  for (std::uint32_t seed = 0; seed < kFits; ++seed) {
    std::mt19937 random(seed);
    std::normal_distribution<double> noise(0, 0.1);
    double v[kUnknowns] = {};
    LeastSquares fit;
    fit.add_block(v, std::vector<ParameterInfo>(kUnknowns));
    for (int i = 0; i < kMeasurements; ++i)
      fit.add(new ceres::AutoDiffCostFunction<Polynomial, 1, kUnknowns>(
                  new Polynomial{2.0 * i / (kMeasurements - 1) - 1, noise(random)}),
              {v}, static_cast<std::uint32_t>(i));
    const auto out = fit.solve({.threads = 1});
    ASSERT_TRUE(out) << out.error().text();
    rejected += out->rejected_ids.size();
    const Eigen::Map<const Eigen::VectorXd> e(v, kUnknowns);
    sum += e.dot(out->fit.covariance.ldlt().solve(e));
  }
  // A normal variable is beyond 4 sigmas in 1 of 15787: of 2000 measurements 0.13 are rejected at most; three
  // have a probability of 3e-4.
  EXPECT_LE(rejected, 2u);
  // Each is 8·F(8, 12), of mean 8·12/10 and variance 64·2·144·18/(8·100·8): 3.29 standard deviations of the
  // mean of a hundred.
  const double mean = 9.6, deviation = std::sqrt(64 * 2 * 144 * 18 / (8 * 100 * 8.0) / kFits);
  EXPECT_NEAR(sum / kFits, mean, 3.29 * deviation);
}

TEST(LeastSquares, OutliersAmongFewMeasurementsAreFound) {
  for (std::uint32_t seed = 0; seed < 20; ++seed) {
    Points p = noisy_line(seed, 12, 1, 2, 0.01);
    p.y[3] += 3, p.y[8] -= 2;
    double v[2] = {0, 0};
    LeastSquares fit;
    fit.add_block(v, {{"a"}, {"b"}});
    for (std::size_t i = 0; i < p.x.size(); ++i)
      fit.add(line(p.x[i], p.y[i]), {v}, static_cast<std::uint32_t>(i));
    const auto out = fit.solve({.threads = 1});
    ASSERT_TRUE(out);
    EXPECT_EQ(out->rejected_ids, (std::vector<std::uint32_t>{3, 8})) << seed;
  }
}

TEST(LeastSquares, DirectionsThatAreFreeTakeNoDegreeOfFreedom) {
  double v[2] = {1, 0}, square = 0, slope = 0, xx = 0;
  LeastSquares fit;
  fit.add_block(v, {{"gain"}, {"offset"}});
  for (int i = 1; i <= 6; ++i) {
    const double y = i * 2.0 + 0.01 * (i % 3);
    fit.add(new ceres::AutoDiffCostFunction<Sum, 1, 2>(new Sum{i * 1.0, y}), {v}, 0);
    slope += i * y, xx += i * i;
  }
  for (int i = 1; i <= 6; ++i) square += std::pow(i * 2.0 + 0.01 * (i % 3) - i * slope / xx, 2);
  for (const bool robust : {false, true}) {
    const auto out = fit.solve({.robust = robust});
    ASSERT_TRUE(out) << out.error().text();
    EXPECT_NEAR(out->fit.scale, std::sqrt(square / 5), 1e-9) << robust;
  }
}

/// Residuals in units of a noise that was stated too small: the covariance grows with them; chance does not
/// make it grow.
TEST(LeastSquares, NoiseThatWasStatedTooSmallEnlargesTheCovariance) {
  int enlarged = 0;
  for (std::uint32_t seed = 0; seed < 100; ++seed)
    for (const double factor : {1.0, 1.4}) {
      const Points p = noisy_line(seed, 200, 2, 3, factor);
      double v[2] = {0, 0};
      LeastSquares fit;
      fit.add_block(v, {{"a"}, {"b"}});
      for (std::size_t i = 0; i < p.x.size(); ++i) fit.add(line(p.x[i], p.y[i]), {v}, 0);
      const auto out = fit.solve({.robust = false, .whitened = true, .threads = 1});
      ASSERT_TRUE(out);
      if (factor == 1.0) {
        enlarged += out->enlarged > 1;
        continue;
      }
      // 1.4² is 9.6 standard deviations of s² of 198 degrees of freedom beyond 1: never missed.
      EXPECT_EQ(out->enlarged, out->fit.scale);
      EXPECT_NEAR(out->fit.find("b")->sigma, out->fit.scale / std::sqrt(6666.5), 1e-3 * out->fit.scale);
    }
  EXPECT_LE(enlarged, 1);  // of 100 at 1e-4: two have a probability of 5e-5
}

TEST(LeastSquares, AFitDoesNotDependOnUnits) {
  const Points p = noisy_line(5, 60, 2, 3, 0.1);
  std::vector<double> relative;
  for (const double unit : {1e-6, 1.0, 1e6}) {
    double v[2] = {0, 0};
    LeastSquares fit;
    fit.add_block(v, {{"a", unit}, {"b", 1e-3}});
    for (std::size_t i = 0; i < p.x.size(); ++i) fit.add(line(p.x[i] * unit * 1e3, p.y[i] * unit), {v}, 0);
    const auto out = fit.solve({.robust = true});
    ASSERT_TRUE(out);
    relative.push_back(out->fit.find("b")->sigma / v[1]);
    EXPECT_NEAR(v[0] / unit, 2, 0.1);
    EXPECT_TRUE(out->fit.weak.empty());
  }
  EXPECT_NEAR(relative[0], relative[1], 1e-6 * relative[1]);
  EXPECT_NEAR(relative[2], relative[1], 1e-6 * relative[1]);
}

TEST(LeastSquares, FewerMeasurementsThanUnknownsAreRefused) {
  double v[2] = {0, 0};
  LeastSquares fit;
  fit.add_block(v, {{"a"}, {"b"}});
  fit.add(line(0, 1), {v}, 0);
  const auto out = fit.solve({});
  ASSERT_FALSE(out);
  EXPECT_EQ(out.error().code, ErrorCode::bad_input);
}

TEST(LeastSquares, HeldAndBoundedParametersSaySo) {
  const Points p = noisy_line(7, 30, 2, 3, 0.1);
  double v[2] = {1.5, 0};
  LeastSquares fit;
  fit.add_block(v, {{.name = "a", .held = true}, {.name = "b", .upper = 1}});
  for (std::size_t i = 0; i < p.x.size(); ++i) fit.add(line(p.x[i], p.y[i]), {v}, 0);
  const auto out = fit.solve({.robust = false});
  ASSERT_TRUE(out);
  EXPECT_EQ(v[0], 1.5);
  EXPECT_TRUE(out->fit.parameters[0].held);
  EXPECT_EQ(out->fit.parameters[0].sigma, 0);
  EXPECT_TRUE(out->fit.parameters[1].at_bound);
}

/// The truth lies within the stated uncertainty as often as it should: χ² of the joint error over 200 seeds,
/// of plain fits, of robust ones, and of robust ones with every tenth measurement wrong.
TEST(LeastSquares, TheCovarianceIsHonest) {
  constexpr int kFits = 200;
  for (const int wrong : {-1, 0, 4}) {
    double chi2 = 0;
    for (std::uint32_t seed = 0; seed < kFits; ++seed) {
      Points p = noisy_line(100 + seed, 40, 2, 3, 0.1);
      for (int k = 0; k < wrong; ++k) p.y[(seed + 10 * static_cast<std::size_t>(k)) % 40] += k % 2 ? 4 : -3;
      double v[2] = {0, 0};
      LeastSquares fit;
      fit.add_block(v, {{"a"}, {"b"}});
      for (std::size_t i = 0; i < p.x.size(); ++i) fit.add(line(p.x[i], p.y[i]), {v}, 0);
      const auto out = fit.solve({.robust = wrong >= 0, .threads = 1});
      ASSERT_TRUE(out);
      const Eigen::Vector2d e(v[0] - 2, v[1] - 3);
      chi2 += e.dot(out->fit.covariance.ldlt().solve(e));
    }
    // Each is 2·F(2, ν), ν = 38 or 34: mean 2·ν/(ν − 2), variance 4·2·ν²·ν/(2·(ν − 2)²·(ν − 4)); at 0.001 of
    // the normal distribution that a sum of 200 is close to.
    const double f = wrong == 4 ? 34 : 38, mean = kFits * 2 * f / (f - 2),
                 deviation = std::sqrt(kFits * 4 * f * f * f / ((f - 2) * (f - 2) * (f - 4)));
    EXPECT_NEAR(chi2, mean, 3.29 * deviation) << wrong;
  }
}

}  // namespace
}  // namespace rigor::calibration
