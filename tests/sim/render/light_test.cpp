// The light of the pictures: levels against the formulas, shadows against geometry.
#include <cmath>
#include <numbers>
#include <vector>

#include "tests/sim/render/render_fixture.h"

namespace rigor {
namespace {

using Light = test::RenderTest;

/// Electrons per second of each pixel.
std::vector<float> linear(CameraSimulator& c) {
  render::PictureRequest q;
  const world::WorldSnapshot w(c.scene());
  const CameraModel& m = c.spec().model;
  q.T_world_sensor = c.T_world_sensor(w, BenchTime());
  q.region = {0, 0, m.width_px, m.height_px};
  std::vector<float> rates(static_cast<std::size_t>(m.width_px * m.height_px));
  const Status s = c.renderer().draw(q, w, rates);
  EXPECT_TRUE(s) << s.error().text();
  return rates;
}

/// Electrons per second where a point of the world appears in the picture.
double rate_at(CameraSimulator& c, const std::vector<float>& rates, const Eigen::Vector3d& p_world) {
  const auto at = c.project_world(p_world, world::WorldSnapshot(c.scene()), BenchTime());
  EXPECT_TRUE(at) << p_world.transpose();
  if (!at) return -1;
  const auto u = std::lround(at->u_px), v = std::lround(at->v_px);
  const CameraModel& m = c.spec().model;
  EXPECT_TRUE(u >= 0 && v >= 0 && u < m.width_px && v < m.height_px) << p_world.transpose();
  if (u < 0 || v < 0 || u >= m.width_px || v >= m.height_px) return -1;
  return rates[static_cast<std::size_t>(v * m.width_px + u)];
}

TEST_F(Light, GroundHasTheRadianceOfALambertianPlane) {
  const world::Scene s = plain_scene();
  CameraSpec c = spec();
  c.T_parent_sensor = look_at({0, 0, 3}, {0, 0.001, 0});
  auto camera = make(c, s);
  ASSERT_TRUE(camera);
  const auto response = c.model.electron_rate_per_radiance(c.model.optics.mono_efficiency);
  double expected = 0;
  for (std::size_t b = 0; b < 4; ++b) {
    const double sun = s.sun.irradiance_w_per_m2[b] * s.sun.direction_to_sun.z();
    const double horizon = s.sky.horizon_radiance_w_per_m2_sr[b],
                 zenith = s.sky.zenith_radiance_w_per_m2_sr[b];
    const double sky = std::numbers::pi * (horizon + 2.0 / 3.0 * (zenith - horizon));
    expected += response[b] * 0.4 / std::numbers::pi * (sun + sky);
  }
  EXPECT_NEAR(rate_at(*camera, linear(*camera), {0.3, 0.2, 0}) / expected, 1.0, 1e-5);
}

// A box of height 1 under a sun of 45 degrees throws a shadow of length 1, away from the sun; of 30 degrees,
// sqrt(3).
TEST_F(Light, ShadowHasTheDirectionAndLengthOfTheSun) {
  for (const world::Shape shape : {world::Shape::box, world::Shape::cylinder})
    for (const double elevation_deg : {45.0, 30.0})
      for (const double azimuth_deg : {0.0, 90.0, 200.0}) {
        world::Scene s = plain_scene();
        const double e = elevation_deg * std::numbers::pi / 180, a = azimuth_deg * std::numbers::pi / 180;
        s.sun.direction_to_sun = {std::cos(a) * std::cos(e), std::sin(a) * std::cos(e), std::sin(e)};
        world::Body body{.name = "body", .shape = shape, .size_m = {0.4, 0.4, 1.0}, .material = 1};
        body.T_node_body.translate(Eigen::Vector3d(0, 0, 0.5));
        // A box turned with the sun, so that its shadow is a rectangle along it.
        body.T_node_body.rotate(Eigen::AngleAxisd(a, Eigen::Vector3d::UnitZ()));
        s.bodies = {body};
        CameraSpec c = spec();
        c.T_parent_sensor = look_at({0, 0, 12}, {0, 0.001, 0});
        auto camera = make(c, s);
        ASSERT_TRUE(camera);
        const std::vector<float> p = linear(*camera);
        const Eigen::Vector3d away(-std::cos(a), -std::sin(a), 0), side(-away.y(), away.x(), 0);
        const double length = 1.0 / std::tan(e);
        const double lit = rate_at(*camera, p, side * 2),
                     dark = rate_at(*camera, p, away * (0.2 + 0.5 * length));
        EXPECT_LT(dark, 0.5 * lit);
        EXPECT_GT(dark, 0.05 * lit) << "the sky still lights a shadow";
        const double margin = 0.08;  // two pixels on the ground
        EXPECT_NEAR(rate_at(*camera, p, away * (0.2 + length - margin)), dark, 1e-3 * dark) << azimuth_deg;
        EXPECT_NEAR(rate_at(*camera, p, away * (0.2 + length + margin)), lit, 1e-3 * lit) << azimuth_deg;
        EXPECT_NEAR(rate_at(*camera, p, away * 0.7 + side * (0.2 - margin)), dark, 1e-3 * dark);
        EXPECT_NEAR(rate_at(*camera, p, away * 0.7 + side * (0.2 + margin)), lit, 1e-3 * lit);
        EXPECT_NEAR(rate_at(*camera, p, -away * (0.2 + margin)), lit, 1e-3 * lit)
            << "no shadow towards the sun";
      }
}

// A row of many bodies: the last one still throws its shadow.
TEST_F(Light, ShadowsOfManyBodiesInARow) {
  world::Scene s = plain_scene();
  for (int i = 0; i < 40; ++i) {
    world::Body b{.name = "b" + std::to_string(i), .size_m = {0.05, 0.05, 0.3}, .material = 1};
    if (i % 3 == 0) b.shape = world::Shape::cylinder;
    b.T_node_body.translate(Eigen::Vector3d(0.02 * i, 0.0, 0.15));
    s.bodies.push_back(b);
  }
  CameraSpec c = spec();
  c.T_parent_sensor = look_at({0, 0, 4}, {0, 0.001, 0});
  auto camera = make(c, s);
  ASSERT_TRUE(camera);
  const std::vector<float> p = linear(*camera);
  const double lit = rate_at(*camera, p, {-0.2, 0.5, 0});
  EXPECT_LT(rate_at(*camera, p, {-0.2, 0, 0}), 0.6 * lit);
  EXPECT_NEAR(rate_at(*camera, p, {-0.4, 0, 0}), lit, 1e-3 * lit);
}

// A pole that leans towards the sun, with its lower half below the ground: the shadow begins where it pierces
// the plane, which is no corner's place.
TEST_F(Light, ABodyThatPiercesTheGroundHasAShadowFromThereOn) {
  world::Scene s = plain_scene();
  s.sun.direction_to_sun = Eigen::Vector3d(0.9, 0, 0.436).normalized();
  world::Body pole{.name = "pole", .size_m = {0.4, 0.4, 4}, .material = 1};
  pole.T_node_body.rotate(Eigen::AngleAxisd(std::numbers::pi / 4, Eigen::Vector3d::UnitY()));
  s.bodies = {pole};
  CameraSpec c = spec();
  c.T_parent_sensor = look_at({-0.7, 0, 3}, {-0.7, 0.001, 0});
  auto camera = make(c, s);
  ASSERT_TRUE(camera);
  const std::vector<float> p = linear(*camera);
  const double lit = rate_at(*camera, p, {-0.7, 1, 0});
  for (const double x : {-0.4, -0.7, -1.0, -1.3}) EXPECT_LT(rate_at(*camera, p, {x, 0, 0}), 0.5 * lit) << x;
  EXPECT_NEAR(rate_at(*camera, p, {-2.2, 0, 0}), lit, 1e-3 * lit);
}

TEST_F(Light, FacesAreLitByTheirAngleToTheSun) {
  world::Scene s = plain_scene();
  s.sky = {};
  s.ground.reset();
  s.sun.direction_to_sun = Eigen::Vector3d(0.36, -0.48, 0.8);
  s.bodies = {{.name = "box", .size_m = {1, 1, 1}, .material = 1}};
  CameraSpec c = spec();
  c.T_parent_sensor = look_at({2.5, -3, 2.5}, {0, 0, 0});
  auto camera = make(c, s);
  ASSERT_TRUE(camera);
  const std::vector<float> p = linear(*camera);
  const double east = rate_at(*camera, p, {0.5, 0, 0}), south = rate_at(*camera, p, {0, -0.5, 0}),
               top = rate_at(*camera, p, {0, 0, 0.5});
  EXPECT_NEAR(east / top, 0.36 / 0.8, 1e-4);
  EXPECT_NEAR(south / top, 0.48 / 0.8, 1e-4);
}

// A white plate before a black sky: the light that is there beside whole pixels tells where its edge lies,
// and eight rays tell it to a sixteenth of a pixel.
TEST_F(Light, AnEdgeLiesBetweenPixelsWhereGeometryPutsIt) {
  world::Scene s = plain_scene();
  s.sky = {};
  s.ground.reset();
  s.sun.direction_to_sun = Eigen::Vector3d(0, -1, 1).normalized();
  for (const double angle_deg : {0.0, 3.0, 45.0, 90.0})
    for (const double shift_px : {0.0, 0.1, 0.3, 0.5, 0.8}) {
      s.bodies = {{.name = "plate", .size_m = {1, 0.1, 1}, .material = 1}};
      s.bodies[0].T_node_body.rotate(
          Eigen::AngleAxisd(angle_deg * std::numbers::pi / 180, Eigen::Vector3d::UnitY()));
      s.bodies[0].T_node_body.translate(Eigen::Vector3d(0.5, 0.05, 0));
      CameraSpec c = spec();
      c.T_parent_sensor = look_at({shift_px / 100, -3, shift_px / 100}, {shift_px / 100, 0, shift_px / 100});
      auto camera = make(c, s);
      ASSERT_TRUE(camera);
      const std::vector<float> p = linear(*camera);
      const double white = rate_at(*camera, p, s.bodies[0].T_node_body * Eigen::Vector3d(0, -0.05, 0.02));
      ASSERT_GT(white, 0);
      // 100 pixels a metre: in the 40 by 40 pixels about the edge's middle lies a half of the plate's light,
      // and what the shift moves in.
      const Eigen::Vector3d edge = s.bodies[0].T_node_body * Eigen::Vector3d(-0.5, -0.05, 0);
      const Eigen::Vector2d n(std::cos(angle_deg * std::numbers::pi / 180),
                              std::sin(angle_deg * std::numbers::pi / 180));
      const auto at = camera->project_world(edge, world::WorldSnapshot(camera->scene()), BenchTime());
      ASSERT_TRUE(at);
      double light = 0, expected = 0;
      for (int v = 100; v < 140; ++v)
        for (int u = 140; u < 180; ++u) {
          light += p[static_cast<std::size_t>(v * c.model.width_px + u)] / white;
          for (int k = 0; k < 400; ++k) {
            const double x = u - 0.475 + 0.05 * (k % 20), y = v - 0.475 + 0.05 * (k / 20);
            if ((x - at->u_px) * n.x() + (y - at->v_px) * n.y() > 0) expected += 1.0 / 400;
          }
        }
      EXPECT_NEAR(light, expected, 40 * 0.0725) << angle_deg << "°, " << shift_px << " px";
    }
}

TEST_F(Light, AnEmptyWorldIsItsSky) {
  world::Scene s;
  s.sky.zenith_radiance_w_per_m2_sr = s.sky.horizon_radiance_w_per_m2_sr = {0.3, 0.3, 0.3, 0.3};
  CameraSpec c = spec();
  auto camera = make(c, s);
  ASSERT_TRUE(camera);
  const auto response = c.model.electron_rate_per_radiance(c.model.optics.mono_efficiency);
  const double expected = 0.3 * (response[0] + response[1] + response[2] + response[3]);
  for (const float v : linear(*camera)) ASSERT_NEAR(v / expected, 1.0, 1e-5);
}

TEST_F(Light, WithinAClosedBodyItIsDark) {
  world::Scene s = plain_scene();
  for (const world::Shape shape : {world::Shape::box, world::Shape::cylinder}) {
    s.bodies = {{.name = "around", .shape = shape, .size_m = {1, 1, 1}, .material = 1}};
    CameraSpec c = spec();
    c.T_parent_sensor =
        look_at({0, 0.495, 0.1}, {0, 5, 0.1});  // 5 mm before the wall, less than the near plane
    auto camera = make(c, s);
    ASSERT_TRUE(camera);
    for (const float v : linear(*camera)) ASSERT_EQ(v, 0.0f);
  }
}

// Everything moved 100 km away: positions are differences in double, so only their rounding to 1.5e-11 m is
// left.
TEST_F(Light, FarFromTheOriginThePictureIsTheSame) {
  const auto picture = [&](const Eigen::Vector3d& shift) {
    world::Scene s = plain_scene();
    s.materials.push_back({.name = "glossy", .reflectance = {0.5, 0.1, 0.1, 0.5}, .roughness = 0.3});
    s.ground->T_world_ground.translate(shift);
    s.ground->noise_contrast = 0.5;
    s.ground->other_material = 2;
    world::Body box{.name = "box", .size_m = {1, 1, 1}, .material = 3};
    box.T_node_body.translate(shift + Eigen::Vector3d(0, 0, 0.5));
    s.bodies = {box};
    CameraSpec c = spec();
    c.T_parent_sensor = look_at(shift + Eigen::Vector3d(3, -4, 2), shift + Eigen::Vector3d(0, 0, 0.3));
    auto camera = make(c, s);
    return camera ? linear(*camera) : std::vector<float>{};
  };
  const std::vector<float> near = picture({0, 0, 0}), far = picture({70710.7, -70710.3, 850.25});
  ASSERT_EQ(near.size(), far.size());
  ASSERT_FALSE(near.empty());
  std::size_t different = 0;
  for (std::size_t i = 0; i < near.size(); ++i)
    if (std::abs(near[i] - far[i]) > 1e-3 * near[i]) ++different;
  // One of a silhouette pixel's eight rays may fall to the other side.
  EXPECT_LT(different, near.size() / 2000);
}

}  // namespace
}  // namespace rigor
