// Data that a blind fit gets wrong: what must happen with each.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>

#include "tests/calibration/camera/board_scene.h"

namespace rigor::calibration {
namespace {

using namespace test;

const CameraModel kTruth = true_camera(LensModel::opencv4);

bool names(const std::vector<WeakDirection>& weak, const std::string& parameter) {
  for (const WeakDirection& w : weak)
    for (const auto& part : w.parts)
      if (part.name == parameter) return true;
  return false;
}
void expect_truth(const CameraFit& fit, const CameraModel& truth, double sigmas = 4) {
  for (const Parameter& p : fit.result.parameters)
    EXPECT_LT(std::abs(p.value - true_value(truth, p.name)), sigmas * p.sigma) << p.name;
}

TEST(CameraHardCase, OneViewIsRefused) {
  Scene scene;
  scene.views = 1;
  const auto fit = fit_camera(random_views(kTruth, scene, 1), {});
  ASSERT_FALSE(fit);
  EXPECT_EQ(fit.error().code, ErrorCode::bad_input);
  EXPECT_NE(fit.error().text().find("at least 2 views"), std::string::npos);
}

TEST(CameraHardCase, FrontoParallelViewsNameTheFocalLength) {
  Scene scene;
  scene.tilt_min_rad = scene.tilt_max_rad = 0;
  scene.noise_px = 0.1;
  // On the axis: to the side the board faces the camera and is tilted in the picture.
  CameraModel narrow = kTruth;
  narrow.lens = {};
  std::mt19937 random(5);
  std::vector<BoardView> views;
  for (int i = 0; i < 10; ++i) {
    Eigen::Isometry3d t = Eigen::Isometry3d::Identity();
    t.linear() = Eigen::AngleAxisd(0.3 * i, Eigen::Vector3d::UnitZ()).toRotationMatrix();
    t.translation() = Eigen::Vector3d(0, 0, 0.4 + 0.05 * i) - t.linear() * Eigen::Vector3d(0.12, 0.075, 0);
    views.push_back(view_of(narrow, scene.board, t, std::to_string(i)));
    add_noise(views.back(), 0.1, random);
  }
  const auto fit = fit_camera(views, {.models = {LensModel::opencv0}});
  ASSERT_TRUE(fit) << fit.error().text();
  EXPECT_TRUE(names(fit->result.weak, "fx_px"));
  ASSERT_FALSE(fit->result.weak.empty());
  EXPECT_NE(fit->result.weak[0].cure.find("tilted"), std::string::npos) << fit->result.weak[0].cure;
  // Never a number that looks sure: the truth is within what is claimed, or nothing is claimed.
  const Parameter* fx = fit->result.find("fx_px");
  EXPECT_TRUE(!std::isfinite(fx->sigma) || fx->sigma > 0.02 * fx->value) << fx->sigma;
}

TEST(CameraHardCase, ViewsAtOneDistanceNameTheFocalLengthWhereTheBoardIsNotTilted) {
  const Board board{BoardKind::chessboard, 9, 6, 0.03};
  std::mt19937 random(6);
  std::vector<BoardView> views;
  for (int i = 0; i < 10; ++i) {
    Eigen::Isometry3d t = Eigen::Isometry3d::Identity();
    t.translation() = Eigen::Vector3d(-0.2 + 0.02 * i, -0.1 + 0.01 * i, 0.6);
    views.push_back(view_of(kTruth, board, t, std::to_string(i)));
    add_noise(views.back(), 0.1, random);
  }
  const auto fit = fit_camera(views, {.models = {LensModel::opencv4}});
  ASSERT_TRUE(fit) << fit.error().text();
  EXPECT_TRUE(names(fit->result.weak, "fx_px") || names(fit->result.weak, "fy_px"));
}

TEST(CameraHardCase, RationalModelOnFewViewsNamesWhatItCannotTell) {
  Scene scene;
  scene.views = 3;
  const auto fit = fit_camera(random_views(kTruth, scene, 2), {.models = {LensModel::opencv8}});
  ASSERT_TRUE(fit) << fit.error().text();
  EXPECT_TRUE(names(fit->result.weak, "k4") || names(fit->result.weak, "k5") ||
              names(fit->result.weak, "k6"));
  EXPECT_FALSE(fit->result.weak[0].cure.empty());
}

TEST(CameraHardCase, FoldOfAStrongDistortionIsNotFittedAcross) {
  CameraModel truth = kTruth;
  truth.fx_px = truth.fy_px = 330;
  truth.lens = {-0.38, 0.0, 0, 0, 0, 0, 0, 0};  // folds 0.62 from the axis: 206 px from the middle
  Scene scene;
  scene.nearest_m = 0.25, scene.farthest_m = 0.6;
  scene.all_corners_seen = false;
  scene.views = 20;
  const auto fit = fit_camera(random_views(truth, scene, 3), {.models = {LensModel::opencv2}});
  ASSERT_TRUE(fit) << fit.error().text();
  expect_truth(*fit, truth);
  EXPECT_LT(fit->rms_per_corner_px, 0.2);
  EXPECT_TRUE(fit->result.rejected.empty());
  // The corners of the picture see no ray.
  EXPECT_TRUE(std::isnan(fit->uncertainty.sigma_px.front())) << fit->uncertainty.sigma_px.front();
  EXPECT_TRUE(std::isnan(fit->uncertainty.sigma_px.back())) << fit->uncertainty.sigma_px.back();
}

TEST(CameraHardCase, StartValuesOffByAFactorOfThreeEndInTheSameFit) {
  const auto views = random_views(kTruth, {}, 4);
  const auto plain = fit_camera(views, {.models = {LensModel::opencv4}});
  ASSERT_TRUE(plain) << plain.error().text();
  for (const double factor : {1.0 / 3, 3.0}) {
    const auto fit =
        fit_camera(views, {.models = {LensModel::opencv4}, .start_fx_px = factor * kTruth.fx_px});
    ASSERT_TRUE(fit) << fit.error().text();
    for (std::size_t i = 0; i < fit->result.parameters.size(); ++i)
      EXPECT_NEAR(fit->result.parameters[i].value, plain->result.parameters[i].value,
                  1e-3 * plain->result.parameters[i].sigma)
          << fit->result.parameters[i].name << " from " << factor;
  }
}

TEST(CameraHardCase, ThirtyPercentOutliersAreNamedAndLeftOut) {
  auto views = random_views(kTruth, {}, 8);
  std::mt19937 random(9);
  std::uniform_real_distribution<double> unit(0, 1);
  std::size_t spoilt = 0;
  for (BoardView& v : views)
    for (BoardPoint& p : v.points) {
      if (unit(random) > 0.3) continue;
      const double angle = 2 * std::numbers::pi * unit(random), by = 3 + 40 * unit(random);
      p.u_px += by * std::cos(angle), p.v_px += by * std::sin(angle);
      ++spoilt;
    }
  ASSERT_GT(spoilt, 150u);
  const auto fit = fit_camera(views, {.models = {LensModel::opencv4}});
  ASSERT_TRUE(fit) << fit.error().text();
  expect_truth(*fit, kTruth);
  EXPECT_EQ(fit->result.rejected.size(), spoilt);
  for (const Rejected& r : fit->result.rejected) EXPECT_NE(r.what.find("corner ("), std::string::npos);
  EXPECT_NEAR(fit->result.scale, 0.1, 0.01);
}

TEST(CameraHardCase, CopiesOfAFrameAddNoCertainty) {
  const auto views = random_views(kTruth, {}, 10);
  auto twice = views;
  twice.insert(twice.end(), views.begin(), views.end());
  const auto once_fit = fit_camera(views, {.models = {LensModel::opencv4}});
  const auto fit = fit_camera(twice, {.models = {LensModel::opencv4}});
  ASSERT_TRUE(once_fit && fit);
  for (std::size_t i = 0; i < fit->result.parameters.size(); ++i)
    EXPECT_NEAR(fit->result.parameters[i].sigma, once_fit->result.parameters[i].sigma,
                1e-6 * once_fit->result.parameters[i].sigma);
  EXPECT_EQ(fit->result.warnings.size(), views.size());
}

TEST(CameraHardCase, TwoHundredViewsOfAThousandCorners) {
  Scene scene;
  scene.board.columns = 40, scene.board.rows = 25, scene.board.spacing_m = 0.006;
  scene.views = 200;
  const auto views = random_views(kTruth, scene, 11);
  ASSERT_EQ(views.size(), 200u);
  const auto fit = fit_camera(views, {.models = {LensModel::opencv4}});
  ASSERT_TRUE(fit) << fit.error().text();
  expect_truth(*fit, kTruth);
  EXPECT_NEAR(fit->result.scale, 0.1, 0.001);
}

TEST(CameraHardCase, LengthsFromMicrometresToThousandsOfKilometresAreAlike) {
  const auto views = random_views(kTruth, {}, 12);
  const auto plain = fit_camera(views, {.models = {LensModel::opencv4}});
  ASSERT_TRUE(plain) << plain.error().text();
  for (const double unit : {1e-6, 1e-3, 1e3, 1e6}) {
    auto scaled = views;
    for (BoardView& v : scaled)
      for (BoardPoint& p : v.points) p.x_m *= unit, p.y_m *= unit;
    const auto fit = fit_camera(scaled, {.models = {LensModel::opencv4}});
    ASSERT_TRUE(fit) << unit << ": " << fit.error().text();
    for (std::size_t i = 0; i < fit->result.parameters.size(); ++i) {
      const Parameter &a = fit->result.parameters[i], &b = plain->result.parameters[i];
      EXPECT_NEAR(a.value, b.value, 1e-3 * b.sigma) << a.name << " at " << unit;
      EXPECT_NEAR(a.sigma, b.sigma, 1e-4 * b.sigma) << a.name << " at " << unit;
    }
    EXPECT_NEAR(fit->T_camera_board[0].translation().z() / unit, plain->T_camera_board[0].translation().z(),
                1e-5);
  }
}

TEST(CameraHardCase, MixedPictureSizesAreRefusedByName) {
  auto views = random_views(kTruth, {}, 13);
  views[4].width_px = 1280, views[4].name = "other.png";
  const auto fit = fit_camera(views, {});
  ASSERT_FALSE(fit);
  EXPECT_NE(fit.error().text().find("other.png"), std::string::npos) << fit.error().text();
}

TEST(CameraHardCase, AStopGivesTheBestSoFarAndMarksIt) {
  const auto views = random_views(kTruth, {}, 14);
  StopSource stop;
  int calls = 0;
  CameraFitOptions options;
  options.stop = stop.token();
  options.progress = [&](double, double) {
    if (++calls == 25) stop.request();
  };
  const auto fit = fit_camera(views, options);
  ASSERT_TRUE(fit) << fit.error().text();
  EXPECT_TRUE(fit->result.interrupted);
  EXPECT_NEAR(fit->result.find("fx_px")->value, kTruth.fx_px, 0.1 * kTruth.fx_px);
}

// A board that turns to and fro in the middle of the picture: corners err alike from view to view (how a
// picture is sampled), and sixty views are no sixty witnesses.
TEST(CameraHardCase, ViewsThatErrAlikeContradictTheirSigmas) {
  const Board board{BoardKind::chessboard, 9, 6, 0.03};
  std::mt19937 random(11);
  std::normal_distribution<double> error(0, 0.2);
  std::array<std::vector<double>, 2> shared;
  for (auto& pattern : shared)
    for (int i = 0; i < 2 * board.columns * board.rows; ++i) pattern.push_back(error(random));
  std::vector<BoardView> views;
  for (int i = 0; i < 60; ++i) {
    Eigen::Isometry3d t = Eigen::Isometry3d::Identity();
    t.linear() = Eigen::AngleAxisd(-0.6 + 0.02 * i, Eigen::Vector3d::UnitY()).toRotationMatrix();
    t.translation() = Eigen::Vector3d(0, 0, 1.6) - t.linear() * Eigen::Vector3d(0.12, 0.075, 0);
    BoardView view = view_of(kTruth, board, t, std::to_string(i));
    const auto& pattern = shared[static_cast<std::size_t>(i % 2)];
    for (std::size_t k = 0; k < view.points.size(); ++k)
      view.points[k].u_px += pattern[2 * k], view.points[k].v_px += pattern[2 * k + 1];
    views.push_back(view);
  }
  const auto fit = fit_camera(views, {.models = {LensModel::opencv4}});
  ASSERT_TRUE(fit) << fit.error().text();
  EXPECT_GT(fit->halves_apart_px, 2 * fit->rms_per_corner_px);
  ASSERT_FALSE(fit->result.not_identifiable.empty());
  for (const auto& [name, why] : fit->result.not_identifiable) {
    const Parameter* p = fit->result.find(name);
    ASSERT_TRUE(p) << name;
    EXPECT_GT(p->halves_apart, 8 * p->sigma) << name;
    EXPECT_NE(why.find("halves of the views"), std::string::npos) << why;
  }
  // Where views err independently the halves agree with the sigmas.
  const auto good = fit_camera(random_views(kTruth, {}, 12), {.models = {LensModel::opencv4}});
  ASSERT_TRUE(good) << good.error().text();
  EXPECT_TRUE(good->result.not_identifiable.empty()) << good->result.not_identifiable[0].second;
  EXPECT_LT(good->result.find("k1")->halves_apart, 8 * good->result.find("k1")->sigma);
}

}  // namespace
}  // namespace rigor::calibration
