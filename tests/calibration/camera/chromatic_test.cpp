// Corners in three colours through the simulator's lens, which magnifies each by its own factor.
#include "calibration/camera/chromatic.h"

#include <gtest/gtest.h>

#include "tests/calibration/camera/board_scene.h"

namespace rigor::calibration {
namespace {

using namespace test;

CameraModel coloured_camera(LensModel lens) {
  CameraModel c = true_camera(lens);
  c.chromatic.magnification = {1.0012, 1, 0.9985};
  return c;
}

std::vector<ColourViews> coloured_views(const CameraModel& camera, int count, double noise_px,
                                        std::uint32_t seed) {
  Scene scene;
  scene.board.columns = 6, scene.board.rows = 4;
  if (camera.projection == Projection::kannala_brandt) scene.nearest_m = 0.15, scene.farthest_m = 0.4;
  std::mt19937 random(seed);
  std::vector<ColourViews> views;
  while (static_cast<int>(views.size()) < count) {
    const Eigen::Isometry3d pose = random_pose(camera, scene, random);
    const std::string name = "picture " + std::to_string(views.size());
    ColourViews planes;
    for (std::size_t c = 0; c < 3; ++c) {
      planes[c] = view_of(camera, scene.board, pose, name);
      for (BoardPoint& p : planes[c].points) {
        const Eigen::Vector3d at = pose * Eigen::Vector3d(p.x_m, p.y_m, 0);
        const auto q = project_ray(camera, {at.x(), at.y(), at.z()}, static_cast<int>(c));
        p.u_px = q->u_px, p.v_px = q->v_px;
      }
      add_noise(planes[c], noise_px, random);
    }
    if (planes[1].points.size() < 24) continue;
    views.push_back(planes);
  }
  return views;
}

class ChromaticLoop : public testing::TestWithParam<LensModel> {};

TEST_P(ChromaticLoop, RecoversTheMagnificationsWithTheUncertaintyThatItStates) {
  const CameraModel truth = coloured_camera(GetParam());
  Judged judged;
  for (std::uint32_t seed = 0; seed < 100; ++seed) {
    const auto fit = fit_chromatic(coloured_views(truth, 8, 0.1, seed),
                                   {.models = {GetParam()}, .robust = seed < 20, .threads = 1});
    ASSERT_TRUE(fit) << fit.error().text();
    const auto& parameters = fit->result.parameters;
    const std::size_t n = parameters.size();
    ASSERT_EQ(parameters[n - 2].name, "magnification_red");
    ASSERT_EQ(parameters[n - 1].name, "magnification_blue");
    Eigen::VectorXd error(static_cast<Eigen::Index>(n));
    for (std::size_t i = 0; i + 2 < n; ++i)
      error[static_cast<Eigen::Index>(i)] = parameters[i].value - true_value(truth, parameters[i].name);
    error[static_cast<Eigen::Index>(n) - 2] = parameters[n - 2].value - truth.chromatic.magnification[0];
    error[static_cast<Eigen::Index>(n) - 1] = parameters[n - 1].value - truth.chromatic.magnification[2];
    EXPECT_EQ(fit->camera.chromatic.magnification[0], parameters[n - 2].value);
    EXPECT_LT(parameters[n - 1].sigma, 2e-4);
    judged.add(fit->result, error);
  }
  EXPECT_LT(std::abs(judged.chi_squared_normal()), kTwoSided001)
      << judged.chi_squared << " of " << judged.degrees;
  EXPECT_LT(std::abs(judged.coverage_normal()), kTwoSided001) << judged.covered << " of " << judged.intervals;
}

INSTANTIATE_TEST_SUITE_P(All, ChromaticLoop, testing::Values(LensModel::opencv2, LensModel::fisheye4),
                         [](const auto& of) { return std::string(lens_model_name(of.param)); });

TEST(Chromatic, ABadCornerOfOneColourIsNamedWithItsColour) {
  auto views = coloured_views(coloured_camera(LensModel::opencv2), 8, 0.1, 1);
  views[3][2].name = "picture 3 blue";
  views[3][2].points[7].v_px += 5;
  const auto fit = fit_chromatic(views, {.models = {LensModel::opencv2}});
  ASSERT_TRUE(fit) << fit.error().text();
  ASSERT_EQ(fit->result.rejected.size(), 1u);
  EXPECT_EQ(fit->result.rejected[0].what, "picture 3 blue corner (1, 1)");
}

}  // namespace
}  // namespace rigor::calibration
