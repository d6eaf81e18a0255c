// A camera as its user sees it: corners where geometry says, grey levels by exposure, noise by EMVA 1288,
// regions.
#include "sim/sensors/camera_simulator.h"

#include <cmath>
#include <numbers>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>

#include "sim/world/world_yaml.h"
#include "tests/paths.h"
#include "tests/sim/render/render_fixture.h"

namespace rigor {
namespace {

using Camera = test::RenderTest;

CameraSpec demo_camera() {
  CameraSpec c;
  c.name = "left";
  c.model.fx_px = c.model.fy_px = 620;
  c.model.cx_px = 322.4;
  c.model.cy_px = 238.1;
  c.model.lens = {.k1 = -0.28, .k2 = 0.09, .p1 = 0.0008, .p2 = -0.0005};
  c.model.vignetting.cos4_weight = 1;
  c.T_parent_sensor = look_at({-0.2, -2.4, 1.5}, {0, 0, 0.45});
  return c;
}

// Found corners and the truth, pixels; empty where none are found.
std::vector<std::pair<Eigen::Vector2d, Eigen::Vector2d>> corners_of(CameraSimulator& camera,
                                                                    const world::WorldSnapshot& w,
                                                                    BenchTime t) {
  const auto& m = camera.spec().model;
  std::vector<std::byte> pixels(camera.full_region_bytes());
  if (!camera.capture({.t_capture = t, .exposure = microseconds(2000)}, w, pixels)) return {};
  const cv::Mat picture(m.height_px, m.width_px, CV_8UC1, pixels.data());
  std::vector<cv::Point2f> found;
  if (!cv::findChessboardCorners(picture, {9, 6}, found)) return {};
  cv::cornerSubPix(picture, found, {5, 5}, {-1, -1},
                   {cv::TermCriteria::COUNT + cv::TermCriteria::EPS, 60, 1e-4});
  const auto truth = camera.project_chessboard(*world::find_body(camera.scene(), "chessboard"), w, t);
  // The board has no up: the finder may number it from the other end.
  double least = 1e9;
  std::vector<std::pair<Eigen::Vector2d, Eigen::Vector2d>> best;
  for (const bool reversed : {false, true}) {
    std::vector<std::pair<Eigen::Vector2d, Eigen::Vector2d>> corners;
    double sum = 0;
    for (std::size_t i = 0; i < found.size(); ++i) {
      const auto& q = truth[reversed ? truth.size() - 1 - i : i];
      if (!q) return {};
      corners.push_back({{found[i].x, found[i].y}, {q->u_px, q->v_px}});
      sum += (corners.back().first - corners.back().second).squaredNorm();
    }
    if (sum < least) least = sum, best = corners;
  }
  return best;
}

TEST_F(Camera, ShowsTheChessboardWhereGeometryPutsIt) {
  const auto scene = world::load_world(rigor::test::source_dir() + "/configs/worlds/turntable.yaml");
  ASSERT_TRUE(scene) << scene.error().text();
  for (const bool noise : {false, true}) {
    CameraSpec c = demo_camera();
    c.noise = noise;
    auto camera = make(c, *scene);
    ASSERT_TRUE(camera);
    world::WorldSnapshot w(*scene);
    // 0.5 rad/s from -0.5 rad at t = 1 s.
    w.joints[*world::find_node(*scene, "turntable")] = {BenchTime(1'000'000'000), -0.5, 0.5};
    for (const int ms : {1000, 1700, 2000, 2600, 3000}) {
      const auto corners = corners_of(*camera, w, BenchTime(ms * 1'000'000ll));
      ASSERT_FALSE(corners.empty()) << "no corners at " << ms << " ms";
      double sum = 0;
      for (const auto& [found, truth] : corners) sum += (found - truth).squaredNorm();
      const double rms_px = std::sqrt(sum / static_cast<double>(corners.size()));
      EXPECT_LT(rms_px, 0.1) << ms << " ms, noise " << noise;
      RecordProperty("rms_px", std::to_string(rms_px));
    }
  }
}

// Blur that leans to one side, as that of a picture sampled between its pixels does, moves corners by
// hundredths of a pixel, at each place of the picture by others: 3e-4 of the focal length. Over many views
// the corners are where they belong: shift and scale of their errors.
TEST_F(Camera, CornersOverManyViewsAreNeitherShiftedNorScaled) {
  const auto scene = world::load_world(rigor::test::source_dir() + "/configs/worlds/turntable.yaml");
  ASSERT_TRUE(scene) << scene.error().text();
  CameraSpec c = demo_camera();
  c.noise = false;
  auto camera = make(c, *scene);
  ASSERT_TRUE(camera);
  world::WorldSnapshot w(*scene);
  w.joints[*world::find_node(*scene, "turntable")] = {BenchTime(), -0.6, 0.5};
  std::vector<std::pair<Eigen::Vector2d, Eigen::Vector2d>> all;
  for (int i = 0; i < 48; ++i) {
    const auto corners = corners_of(*camera, w, BenchTime(i * 50'000'000ll));
    all.insert(all.end(), corners.begin(), corners.end());
  }
  ASSERT_GT(all.size(), 2000U);
  Eigen::Vector2d shift = Eigen::Vector2d::Zero(), centre = shift;
  for (const auto& [found, truth] : all) {
    shift += (found - truth) / static_cast<double>(all.size());
    centre += truth / static_cast<double>(all.size());
  }
  double along = 0, squares = 0;
  for (const auto& [found, truth] : all) {
    along += (found - truth - shift).dot(truth - centre);
    squares += (truth - centre).squaredNorm();
  }
  EXPECT_LT(shift.norm(), 0.008);
  EXPECT_LT(std::abs(along / squares), 6e-5);
}

TEST_F(Camera, GreyLevelIsLinearInExposureUpToSaturation) {
  CameraSpec c = spec();
  c.model.noise.black_level_dn = 40;
  c.model.noise.dark_current_e_per_s = 0;
  c.T_parent_sensor = look_at({0, 0, 3}, {0, 0.001, 0});
  auto camera = make(c, plain_scene());
  ASSERT_TRUE(camera);
  const auto mean = [&](Duration exposure, double gain_db = 0) {
    return mean16(shoot(*camera, {.exposure = exposure, .gain_db = gain_db}));
  };
  EXPECT_EQ(mean(Duration()), 40.0);
  const double slope = (mean(milliseconds(1)) - 40) / 1e-3;
  ASSERT_GT(slope, 1e4);
  for (const double full : {0.1, 0.3, 0.6, 0.95}) {
    const double exposure_s = full * (4095 - 40) / slope;
    EXPECT_NEAR(mean(seconds_from(exposure_s)), 40 + slope * exposure_s, 0.5 + 2e-4 * 4095) << full;
  }
  EXPECT_NEAR(mean(microseconds(500), 6.0) - 40, (mean(microseconds(500)) - 40) * std::pow(10, 0.3), 2.0);
  EXPECT_EQ(mean(seconds(1)), 4095.0);
}

TEST_F(Camera, ARegionIsACropOfTheWholePicture) {
  const auto scene = world::load_world(rigor::test::source_dir() + "/configs/worlds/turntable.yaml");
  ASSERT_TRUE(scene);
  for (const bool noise : {false, true}) {
    CameraSpec c = demo_camera();
    c.noise = noise;
    auto camera = make(c, *scene);
    ASSERT_TRUE(camera);
    const auto whole = shoot(*camera, {.capture_index = 3, .exposure = milliseconds(2)});
    for (const render::Region& r : {render::Region{0, 0, 640, 480}, render::Region{201, 133, 155, 97},
                                    render::Region{639, 479, 1, 1}, render::Region{0, 300, 640, 1}}) {
      const auto part = shoot(*camera, {.capture_index = 3, .exposure = milliseconds(2), .region = r});
      for (int v = 0; v < r.height_px; ++v)
        for (int u = 0; u < r.width_px; ++u)
          ASSERT_EQ(part[static_cast<std::size_t>(v * r.width_px + u)],
                    whole[static_cast<std::size_t>((v + r.offset_y_px) * 640 + u + r.offset_x_px)])
              << u << ", " << v << " of " << r.width_px << "x" << r.height_px << ", noise " << noise;
    }
  }
}

// EMVA 1288 by its own method, two pictures of a flat field: temporal variance = half the variance of their
// difference. Its relative standard deviation over n pixels is sqrt(2/n); 4 sigma.
TEST_F(Camera, TemporalNoiseFollowsEmva1288) {
  world::Scene s;
  s.sky.zenith_radiance_w_per_m2_sr = s.sky.horizon_radiance_w_per_m2_sr = {0.05, 0.05, 0.05, 0.05};
  CameraSpec c = spec();
  c.noise = true;
  c.model.noise.black_level_dn = 100;
  c.model.noise.system_gain_dn_per_e = 0.8;
  c.model.noise.read_noise_e = 6;
  c.model.noise.prnu = 0.02;
  c.model.noise.dsnu_e = 3;
  c.model.noise.dark_current_e_per_s = 0;
  auto camera = make(c, s);
  ASSERT_TRUE(camera);
  const double n = 320 * 240;
  const auto moments = [&](Duration exposure) {
    const auto a = shoot(*camera, {.capture_index = 10, .exposure = exposure});
    const auto b = shoot(*camera, {.capture_index = 11, .exposure = exposure});
    double sum = 0, difference = 0, squares = 0, product = 0;
    for (int i = 0; i < static_cast<int>(n); ++i) {
      const double x = at16(a, 1, 0, i), y = at16(b, 1, 0, i);
      sum += 0.5 * (x + y);
      difference += x - y;
      squares += (x - y) * (x - y);
      product += x * y;
    }
    const double mean = sum / n;
    // The covariance of the two is what stays: the fixed pattern.
    return std::array{mean, 0.5 * (squares / n - std::pow(difference / n, 2)), product / n - mean * mean};
  };
  const double k = 0.8;
  const auto dark = moments(Duration());
  EXPECT_NEAR(dark[0], 100, 0.1);
  EXPECT_NEAR(dark[1] / (k * k * 36 + 1.0 / 12), 1.0, 4 * std::sqrt(2 / n));
  EXPECT_NEAR(dark[2], k * k * 9, 4 * (k * k * 36 + 9) / std::sqrt(n));
  for (const int us : {60, 1000, 3000}) {
    const auto lit = moments(microseconds(us));
    ASSERT_LT(lit[0], 3800) << "within the linear range";
    ASSERT_GT(lit[0], 101);
    EXPECT_NEAR(lit[1] / (dark[1] + k * (lit[0] - dark[0])), 1.0, 6 * std::sqrt(2 / n)) << us;
    const double pattern = k * k * 9 + std::pow(0.02 * (lit[0] - dark[0]), 2);
    EXPECT_NEAR(lit[2], pattern,
                4 * std::sqrt(2 * pattern * pattern + 4 * pattern * lit[1] + lit[1] * lit[1]) / std::sqrt(n))
        << us;
  }
}

TEST_F(Camera, RidesOnTheNodeThatCarriesIt) {
  world::Scene s = plain_scene();
  world::Node arm;
  arm.name = "arm";
  arm.hinge = world::Hinge{};
  s.nodes = {arm};
  CameraSpec c = spec();
  c.parent_node = "arm";
  c.T_parent_sensor = look_at({1, 0, 1}, {5, 0, 1});
  auto camera = make(c, s);
  ASSERT_TRUE(camera);
  world::WorldSnapshot w(s);
  w.joints[0] = {BenchTime(0), 0.0, std::numbers::pi / 2};
  const BenchTime t(1'000'000'000);
  EXPECT_LT((camera->T_world_sensor(w, t).translation() - Eigen::Vector3d(0, 1, 1)).norm(), 1e-12);
  const auto ahead = camera->project_world({0, 5, 1}, w, t);
  ASSERT_TRUE(ahead);
  EXPECT_NEAR(ahead->u_px, c.model.cx_px, 1e-9);
  EXPECT_NEAR(ahead->v_px, c.model.cy_px, 1e-9);
  EXPECT_FALSE(camera->project_world({0, -5, 1}, w, t));
}

}  // namespace
}  // namespace rigor
