// A board that moves before a camera whose rows are read one after the other.
#include "calibration/camera/rolling_shutter.h"

#include <gtest/gtest.h>

#include "tests/calibration/camera/board_scene.h"
#include "tests/calibration/camera/moving_board.h"

namespace rigor::calibration {
namespace {

using namespace test;

CameraModel rolling_camera(double line_time_s) {
  CameraModel c = true_camera(LensModel::opencv2);
  c.shutter.line_time_s = line_time_s;
  return c;
}

TEST(RollingShutter, RecoversLineTimeAndLensWithTheUncertaintyThatItStates) {
  const CameraModel truth = rolling_camera(30e-6);  // 14 ms for the picture
  Judged judged;
  int of_line = 0;
  double largest_sigma_s = 0;
  for (std::uint32_t seed = 0; seed < 100; ++seed) {
    const auto fit = fit_rolling_shutter(moving_board_views(truth, seed, 1, 0.1, 15),
                                         {.models = {LensModel::opencv2}, .robust = seed < 20, .threads = 1});
    ASSERT_TRUE(fit) << fit.error().text();
    const auto& parameters = fit->result.parameters;
    ASSERT_EQ(parameters.size(), 7u) << seed;
    ASSERT_EQ(parameters.back().name, "line_time_s");
    Eigen::VectorXd error(7);
    for (std::size_t i = 0; i < 6; ++i)
      error[static_cast<Eigen::Index>(i)] = parameters[i].value - true_value(truth, parameters[i].name);
    error[6] = parameters[6].value - truth.shutter.line_time_s;
    of_line += std::abs(error[6]) <= 1.959964 * parameters[6].sigma;
    largest_sigma_s = std::max(largest_sigma_s, parameters[6].sigma);
    judged.add(fit->result, error);
  }
  EXPECT_LT(std::abs(judged.chi_squared_normal()), kTwoSided001)
      << judged.chi_squared << " of " << judged.degrees;
  EXPECT_LT(std::abs(judged.coverage_normal()), kTwoSided001) << judged.covered << " of " << judged.intervals;
  EXPECT_LT(std::abs((of_line - 95) / std::sqrt(100 * 0.95 * 0.05)), kTwoSided001) << of_line << " of 100";
  EXPECT_LT(largest_sigma_s, 0.1 * truth.shutter.line_time_s);
  RecordProperty("covered_line_times", of_line);
  RecordProperty("largest_sigma_us", std::to_string(1e6 * largest_sigma_s));
  RecordProperty("chi_squared_in_sigmas", std::to_string(judged.chi_squared_normal()));
}

TEST(RollingShutter, TheMotionIsNotTakenForALens) {
  const CameraModel truth = rolling_camera(30e-6);
  const auto views = moving_board_views(truth, 3, 1, 0.05, 40);
  const auto blind = fit_camera(views, {.models = {LensModel::opencv2}});
  const auto fit = fit_rolling_shutter(views, {});
  ASSERT_TRUE(blind && fit);
  EXPECT_GT(blind->rms_per_corner_px, 2 * fit->rms_per_corner_px);
  EXPECT_NEAR(fit->rms_per_corner_px, 0.05 * std::sqrt(2.0), 0.005);
  EXPECT_EQ(fit->lens_model, LensModel::opencv2);  // chosen among four
  EXPECT_NEAR(fit->camera.shutter.line_time_s, 30e-6, 1e-6);
  EXPECT_TRUE(fit->result.rejected.empty());
}

TEST(RollingShutter, AGlobalShutterIsToldFromARollingOne) {
  const auto fit = fit_rolling_shutter(moving_board_views(rolling_camera(0), 5, 1, 0.1, 40),
                                       {.models = {LensModel::opencv2}});
  ASSERT_TRUE(fit) << fit.error().text();
  const Parameter* line = fit->result.find("line_time_s");
  ASSERT_NE(line, nullptr);
  EXPECT_LT(std::abs(line->value), 4 * line->sigma);
  EXPECT_LT(line->sigma, 2e-6);
  ASSERT_FALSE(fit->result.warnings.empty());
  EXPECT_NE(fit->result.warnings.back().find("global shutter"), std::string::npos);
}

void expect_not_identifiable(const Result<CameraFit>& fit, const std::string& because) {
  ASSERT_TRUE(fit) << fit.error().text();
  EXPECT_EQ(fit->result.find("line_time_s"), nullptr);
  ASSERT_EQ(fit->result.not_identifiable.size(), 1u);
  EXPECT_EQ(fit->result.not_identifiable[0].first, "line_time_s");
  EXPECT_NE(fit->result.not_identifiable[0].second.find(because), std::string::npos)
      << fit->result.not_identifiable[0].second;
  EXPECT_EQ(fit->camera.shutter.line_time_s, 0);
  EXPECT_NE(fit->result.find("fx_px"), nullptr);
}

TEST(RollingShutter, WhereTheDataDoNotDetermineItTheReasonIsSaid) {
  const CameraModel truth = rolling_camera(30e-6);
  const CameraFitOptions options{.models = {LensModel::opencv2}};
  auto untimed = moving_board_views(truth, 6);
  for (BoardView& v : untimed) v.t_s = NAN;
  expect_not_identifiable(fit_rolling_shutter(untimed, options), "no times");
  auto apart = moving_board_views(truth, 6);
  for (BoardView& v : apart) v.t_s *= 30;
  expect_not_identifiable(fit_rolling_shutter(apart, options), "follow each other");
  // Stations between which the board was carried, at each of which it stood still.
  Scene scene;
  scene.views = 10;
  std::vector<BoardView> still;
  std::mt19937 random(8);
  for (const BoardView& station : random_views(true_camera(LensModel::opencv2), scene, 7))
    for (int k = 0; k < 3; ++k) {
      still.push_back(station);
      still.back().t_s = 5 * static_cast<double>(still.size() / 3) + k / 30.0;
      add_noise(still.back(), 0.05, random);
    }
  for (std::size_t i = 0; i < still.size(); ++i)
    still[i].t_s = 5.0 * static_cast<double>(i / 3) + static_cast<double>(i % 3) / 30;
  expect_not_identifiable(fit_rolling_shutter(still, options), "moved while the rows were read");
}

TEST(RollingShutter, AViewOfWhichNothingSaysHowItMovedIsLeftOutByName) {
  auto views = moving_board_views(rolling_camera(30e-6), 9);
  BoardView alone = views[4];
  alone.name = "alone", alone.t_s = 100;
  alone.points[0].u_px += 0.01;  // no copy
  views.push_back(alone);
  const auto fit = fit_rolling_shutter(views, {.models = {LensModel::opencv2}});
  ASSERT_TRUE(fit) << fit.error().text();
  ASSERT_NE(fit->result.find("line_time_s"), nullptr);
  bool named = false;
  for (const auto& w : fit->result.warnings) named = named || w.starts_with("alone: left out");
  EXPECT_TRUE(named);
}

}  // namespace
}  // namespace rigor::calibration
