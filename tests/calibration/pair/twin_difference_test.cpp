#include "calibration/pair/twin_difference.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "calibration/pair/board_pose.h"

namespace rigor::calibration {
namespace {

std::vector<TwinElement> sample(std::mt19937& random, double bias, double sigma, double step) {
  std::normal_distribution<double> noise(0, sigma);
  std::vector<TwinElement> s;
  for (std::uint64_t k = 0; k < 2000; ++k) {
    const double x = 5 + 0.001 * static_cast<double>(k) + bias + noise(random);
    s.push_back({k, step > 0 ? step * std::round(x / step) : x});
  }
  return s;
}

TEST(TwinDifference, BiasAndBothNoisesComeOutAsTheyWentIn) {
  std::mt19937 random(1);
  TwinComparer comparer;
  for (int i = 0; i < 20; ++i) {
    auto real = sample(random, 0, 0.01, 0), simulated = sample(random, 0.03, 0.02, 0);
    real.resize(1990);                  // the real one lost ten
    simulated[7].value = std::nan("");  // the twin has no return there
    comparer.add(real, simulated);
  }
  const TwinDifference t = comparer.result();
  EXPECT_EQ(t.samples, 20u);
  EXPECT_EQ(t.only_real, 20u);
  EXPECT_EQ(t.only_simulated, 200u);
  EXPECT_EQ(t.elements, 20u * 1989);
  EXPECT_NEAR(t.bias, 0.03, 4 * 0.0224 / std::sqrt(20 * 1989.0));
  EXPECT_NEAR(t.real_noise, 0.01, 2e-4);
  EXPECT_NEAR(t.simulated_noise, 0.02, 4e-4);
  // Two normal distributions with 1 and 2 standard deviations are 0.1626 apart at the most.
  EXPECT_NEAR(t.noise_distance, 0.1626, 0.012);
  EXPECT_LT(t.q05, t.median);
}

TEST(TwinDifference, ATwinOfTheSameNoiseAndRoundingIsAlike) {
  std::mt19937 random(2);
  TwinComparer comparer;
  for (int i = 0; i < 20; ++i) comparer.add(sample(random, 0, 0.01, 0.002), sample(random, 0, 0.01, 0.002));
  EXPECT_LT(comparer.result().noise_distance, 1.95 * std::sqrt(2 / (19 * 2000.0)));  // at 0.001
}

// A noise of 0.8 DN, rounded to whole grey values: of differences of whole numbers the plain quantiles would
// say 0.52 or 1.05.
TEST(TwinDifference, NoiseOfWholeNumbersIsBetweenThem) {
  std::mt19937 random(4);
  TwinComparer comparer(1);
  const auto grey = [&](double sigma) {
    auto s = sample(random, 0, 0, 0);
    std::normal_distribution<double> noise(0, sigma);
    for (auto& e : s) e.value = std::round(100 + 10 * e.value + noise(random));
    return s;
  };
  for (int i = 0; i < 20; ++i) comparer.add(grey(0.8), grey(1.2));
  const TwinDifference t = comparer.result();
  // Rounding adds a twelfth to the variance; within a step the density is taken as even, which costs 6 %
  // here.
  EXPECT_NEAR(t.real_noise, std::sqrt(0.64 + 1 / 12.0), 0.06);
  EXPECT_NEAR(t.simulated_noise, std::sqrt(1.44 + 1 / 12.0), 0.06);
}

TEST(TwinDifference, WhatItSaysOfItsOwnUncertaintyHoldsOverAHundredSeeds) {
  int inside[4] = {};
  for (std::uint32_t seed = 0; seed < 100; ++seed) {
    std::mt19937 random(seed);
    std::normal_distribution<double> slow(0, 0.002);
    TwinComparer comparer;
    for (int i = 0; i < 41; ++i) {
      // Each sample of the twin is off by something of its own.
      auto real = sample(random, 0, 0.01, 0), simulated = sample(random, 0.03 + slow(random), 0.02, 0);
      real.resize(300), simulated.resize(300);
      comparer.add(real, simulated);
    }
    const TwinDifference t = comparer.result();
    // Differences of two samples see that, too: the twin's noise is that much larger.
    const double noise = std::sqrt(0.02 * 0.02 + 0.002 * 0.002);
    const double error[4] = {t.bias - 0.03, t.real_noise - 0.01, t.simulated_noise - noise,
                             t.simulated_noise / t.real_noise - noise / 0.01};
    for (int k = 0; k < 4; ++k) inside[k] += std::abs(error[k]) <= 2.262 * std::sqrt(t.covariance(k, k));
  }
  // Student's t of 9 degrees (10 stretches); binomial limits at 0.001 of 100 with 0.95.
  for (int k = 0; k < 4; ++k) {
    EXPECT_GE(inside[k], 86) << k;
    EXPECT_LE(inside[k], 100) << k;
  }
}

TEST(TwinDifference, FewSamplesSayNothingOfTheirUncertainty) {
  std::mt19937 random(5);
  TwinComparer comparer;
  for (int i = 0; i < 5; ++i) comparer.add(sample(random, 0, 1, 0), sample(random, 0, 1, 0));
  EXPECT_TRUE(std::isinf(comparer.result().covariance(0, 0)));
}

TEST(TwinDifference, OneSampleHasNoNoise) {
  std::mt19937 random(3);
  TwinComparer comparer;
  comparer.add(sample(random, 0, 1, 0), sample(random, 0, 1, 0));
  EXPECT_TRUE(std::isnan(comparer.result().real_noise));
  EXPECT_TRUE(std::isnan(TwinComparer().result().bias));
}

// ---------------------------------------------------------------- the board's pose

CameraModel camera() {
  CameraModel c;
  c.width_px = 640, c.height_px = 480;
  c.fx_px = 530, c.fy_px = 533, c.cx_px = 321, c.cy_px = 238;
  c.lens.k1 = -0.28, c.lens.k2 = 0.08;
  return c;
}

BoardView view_of(const Eigen::Isometry3d& T_camera_board, double noise_px, std::uint32_t seed) {
  std::mt19937 random(seed);
  std::normal_distribution<double> noise(0, 1);
  BoardView v{"view", 640, 480, {}};
  for (int r = 0; r < 6; ++r)
    for (int c = 0; c < 9; ++c) {
      const Eigen::Vector3d p = T_camera_board * Eigen::Vector3d(0.05 * c, 0.05 * r, 0);
      const auto at = project(camera(), {p.x(), p.y(), p.z()});
      if (!at) continue;
      BoardPoint q{
          c, r, 0.05 * c, 0.05 * r, at->u_px + noise_px * noise(random), at->v_px + noise_px * noise(random)};
      v.points.push_back(q);
    }
  return v;
}

TEST(BoardPose, ThePlaneIsWhereItsCovarianceSays) {
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.linear() =
      (Eigen::AngleAxisd(0.4, Eigen::Vector3d::UnitY()) * Eigen::AngleAxisd(-0.3, Eigen::Vector3d::UnitX()))
          .toRotationMatrix();
  T.translation() = Eigen::Vector3d(-0.2, -0.1, 1.5);
  double chi2 = 0;
  for (std::uint32_t seed = 0; seed < 100; ++seed) {
    const auto pose = pose_of_board(view_of(T, 0.1, seed), camera());
    ASSERT_TRUE(pose) << pose.error().text();
    const Eigen::Isometry3d d = T.inverse() * pose->T_camera_board;
    const Eigen::AngleAxisd turn(d.linear());
    const Eigen::Vector3d e(turn.axis().x() * turn.angle(), turn.axis().y() * turn.angle(),
                            d.translation().z());
    chi2 += e.dot(pose->plane_covariance.inverse() * e);
  }
  const auto quantile = [](double z) {
    const double k = 300, c = 2 / (9 * k);
    return k * std::pow(1 - c + z * std::sqrt(c), 3);
  };
  EXPECT_GT(chi2, quantile(-3.2905));
  EXPECT_LT(chi2, quantile(3.2905));
}

TEST(BoardPose, APictureOfAnotherSizeIsRefused) {
  auto v = view_of(Eigen::Isometry3d(Eigen::Translation3d(0, 0, 1)), 0, 0);
  v.width_px = 320;
  const auto pose = pose_of_board(v, camera());
  ASSERT_FALSE(pose);
  EXPECT_NE(pose.error().text().find("640x480"), std::string::npos);
}

}  // namespace
}  // namespace rigor::calibration
