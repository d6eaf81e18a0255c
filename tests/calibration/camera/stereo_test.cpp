#include "calibration/camera/stereo_fit.h"

#include <gtest/gtest.h>

#include "tests/calibration/camera/board_scene.h"

namespace rigor::calibration {
namespace {

using namespace test;

Eigen::Isometry3d true_rig() {
  Eigen::Isometry3d t = Eigen::Isometry3d::Identity();
  t.linear() = Eigen::AngleAxisd(0.06, Eigen::Vector3d(0.3, 0.9, -0.2).normalized()).toRotationMatrix();
  t.translation() = Eigen::Vector3d(0.12, 0.003, -0.005);
  return t;
}

struct Rig {
  CameraModel left = true_camera(LensModel::opencv4), right = true_camera(LensModel::opencv4);
  Rig() { right.fx_px = 541, right.fy_px = 540, right.cx_px = 315, right.lens.k1 = -0.3; }
};

std::vector<StereoPair> pairs_of(const Rig& rig, int count, double noise_px, std::uint32_t seed) {
  Scene scene;
  scene.board.columns = 7, scene.board.rows = 5;
  scene.nearest_m = 0.5, scene.farthest_m = 1.0;
  std::mt19937 random(seed);
  std::vector<StereoPair> pairs;
  while (static_cast<int>(pairs.size()) < count) {
    const Eigen::Isometry3d T_left_board = random_pose(rig.left, scene, random);
    const std::string name = std::to_string(pairs.size());
    StereoPair p{view_of(rig.left, scene.board, T_left_board, name),
                 view_of(rig.right, scene.board, true_rig().inverse() * T_left_board, name)};
    // Either camera may miss a few corners.
    if (p.left.points.size() < 20 || p.right.points.size() < 20) continue;
    add_noise(p.left, noise_px, random), add_noise(p.right, noise_px, random);
    pairs.push_back(std::move(p));
  }
  return pairs;
}

Eigen::VectorXd error_of(const StereoFit& fit, const Rig& rig) {
  const Eigen::AngleAxisd turn(true_rig().rotation());
  const Eigen::Vector3d w = turn.angle() * turn.axis(), t = true_rig().translation();
  Eigen::VectorXd e(static_cast<Eigen::Index>(fit.result.parameters.size()));
  for (std::size_t i = 0; i < fit.result.parameters.size(); ++i) {
    const Parameter& p = fit.result.parameters[i];
    const double truth = i < 3                         ? w[static_cast<Eigen::Index>(i)]
                         : i < 6                       ? t[static_cast<Eigen::Index>(i) - 3]
                         : p.name.starts_with("left.") ? true_value(rig.left, p.name.substr(5))
                                                       : true_value(rig.right, p.name.substr(6));
    e[static_cast<Eigen::Index>(i)] = p.value - truth;
  }
  return e;
}

TEST(Stereo, RecoversRigAndBothCamerasWithTheUncertaintyThatItStates) {
  const Rig rig;
  Judged judged;
  for (std::uint32_t seed = 0; seed < 100; ++seed) {
    // With 6 pairs instead the chi-squared is 1.16 a degree: the fit is then not linear within its sigma.
    const auto fit = fit_stereo(pairs_of(rig, 8, 0.1, seed), {.robust = seed < 20, .threads = 1});
    ASSERT_TRUE(fit) << fit.error().text();
    ASSERT_EQ(fit->result.parameters.size(), 22u);
    judged.add(fit->result, error_of(*fit, rig));
  }
  EXPECT_LT(std::abs(judged.chi_squared_normal()), kTwoSided001)
      << judged.chi_squared << " of " << judged.degrees;
  EXPECT_LT(std::abs(judged.coverage_normal()), kTwoSided001) << judged.covered << " of " << judged.intervals;
}

TEST(Stereo, WithHeldIntrinsicsTheTransformAloneIsFittedAndSaidSo) {
  const Rig rig;
  Judged judged;
  for (std::uint32_t seed = 0; seed < 100; ++seed) {
    const auto fit =
        fit_stereo(pairs_of(rig, 3, 0.1, seed), {.left = rig.left, .right = rig.right, .threads = 1});
    ASSERT_TRUE(fit) << fit.error().text();
    ASSERT_EQ(fit->result.parameters.size(), 6u);
    ASSERT_EQ(fit->result.warnings.size(), 1u);
    judged.add(fit->result, error_of(*fit, rig));
  }
  EXPECT_LT(std::abs(judged.chi_squared_normal()), kTwoSided001)
      << judged.chi_squared << " of " << judged.degrees;
  EXPECT_LT(std::abs(judged.coverage_normal()), kTwoSided001) << judged.covered << " of " << judged.intervals;
}

TEST(Stereo, BadCornersAreNamedWithTheirSide) {
  const Rig rig;
  auto pairs = pairs_of(rig, 8, 0.1, 7);
  pairs[3].right.points[5].u_px += 6;
  const auto fit = fit_stereo(pairs, {.threads = 1});
  ASSERT_TRUE(fit) << fit.error().text();
  ASSERT_EQ(fit->result.rejected.size(), 1u);
  EXPECT_EQ(fit->result.rejected[0].what.substr(0, 7), "right 3");
}

TEST(Stereo, PicturesOfDifferentInstantsAreRefused) {
  const Rig rig;
  auto pairs = pairs_of(rig, 8, 0.1, 7);
  for (std::size_t i = 0; i + 1 < pairs.size(); i += 2) std::swap(pairs[i].right, pairs[i + 1].right);
  const auto fit = fit_stereo(pairs, {.threads = 1});
  ASSERT_FALSE(fit);
  EXPECT_NE(fit.error().text().find("same instants"), std::string::npos) << fit.error().text();
}

}  // namespace
}  // namespace rigor::calibration
