// The loop closes: views through the simulator's lens, fitted, give the truth back within what the fit
// claims.
#include <gtest/gtest.h>

#include "tests/calibration/camera/board_scene.h"

namespace rigor::calibration {
namespace {

using namespace test;

class CameraLoop : public testing::TestWithParam<LensModel> {};

TEST_P(CameraLoop, RecoversTheTruthWithTheUncertaintyThatItStates) {
  const LensModel model = GetParam();
  const CameraModel truth = true_camera(model);
  Scene scene;
  scene.board.columns = 7, scene.board.rows = 5, scene.views = 10;
  if (model == LensModel::opencv8) {
    // k1 and k4 pull almost the same way: beyond this noise the fit is no longer linear within its sigma.
    scene.noise_px = 0.03;
    scene.views = 16, scene.nearest_m = 0.1, scene.farthest_m = 0.3;
    scene.all_corners_seen = false;
  }
  if (model == LensModel::fisheye4) scene.nearest_m = 0.15, scene.farthest_m = 0.4;
  Judged judged;
  double scale = 0;
  for (std::uint32_t seed = 0; seed < 100; ++seed) {
    const auto views = random_views(truth, scene, seed);
    ASSERT_EQ(static_cast<int>(views.size()), scene.views);
    const auto fit = fit_camera(
        views, {.models = {model}, .robust = model == LensModel::opencv4 || seed < 20, .threads = 1});
    ASSERT_TRUE(fit) << fit.error().text();
    const auto& parameters = fit->result.parameters;
    Eigen::VectorXd error(static_cast<Eigen::Index>(parameters.size()));
    for (std::size_t i = 0; i < parameters.size(); ++i)
      error[static_cast<Eigen::Index>(i)] = parameters[i].value - true_value(truth, parameters[i].name);
    judged.add(fit->result, error);
    scale += fit->result.scale / 100;
  }
  EXPECT_LT(std::abs(judged.chi_squared_normal()), kTwoSided001)
      << judged.chi_squared << " of " << judged.degrees;
  EXPECT_LT(std::abs(judged.coverage_normal()), kTwoSided001) << judged.covered << " of " << judged.intervals;
  EXPECT_NEAR(scale, scene.noise_px, 0.01 * scene.noise_px);
  RecordProperty("chi_squared_in_sigmas", std::to_string(judged.chi_squared_normal()));
  RecordProperty("coverage_in_sigmas", std::to_string(judged.coverage_normal()));
}

INSTANTIATE_TEST_SUITE_P(All, CameraLoop,
                         testing::Values(LensModel::opencv0, LensModel::opencv4, LensModel::opencv5,
                                         LensModel::opencv8, LensModel::fisheye4),
                         [](const auto& of) { return std::string(lens_model_name(of.param)); });

}  // namespace
}  // namespace rigor::calibration
