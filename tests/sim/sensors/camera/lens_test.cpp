// Where light falls: projection, colours, focus.
#include <cmath>

#include "sim/world/pose.h"
#include "tests/sim/sensors/camera/plate_world.h"

namespace rigor::test {
namespace {

CameraModel distorted() {
  CameraModel m = small_camera();
  m.lens = {.k1 = -0.25, .k2 = 0.06, .p1 = 0.002, .p2 = -0.003};
  return m;
}
CameraModel fisheye() {
  CameraModel m = small_camera(22);
  m.projection = Projection::kannala_brandt;
  m.fisheye = {.k1 = -0.03, .k2 = 0.004};
  return m;
}

TEST_P(CameraOptics, ASmallBodyAppearsWhereTheModelProjectsIt) {
  for (const CameraModel& m : {small_camera(), distorted(), fisheye()})
    for (const auto& [u, v] : {std::pair{31.5, 23.5}, {8.2, 7.6}, {55.7, 20.1}, {30.3, 41.9}}) {
      const auto ray = unproject_ray(m, {u, v});
      ASSERT_TRUE(ray);
      // Turned towards the camera, four pixels wide.
      const Eigen::Vector3d d(ray->x, ray->z, -ray->y);
      Eigen::Isometry3d T = at_place(3 * d);
      T.linear() = rotation_between(Eigen::Vector3d::UnitY(), d).toRotationMatrix();
      world_ = {};
      const auto half = static_cast<float>(3 * 2 / m.fx_px);
      world_.add({{half, 1e-3F, half}, [T](double) { return T; }});
      const Spot s = spot(shoot(m, fine()));
      ASSERT_GT(s.sum, 1) << u << ", " << v;
      EXPECT_NEAR(s.u, u, 0.1) << static_cast<int>(m.projection) << " k1 " << m.lens.k1;
      EXPECT_NEAR(s.v, v, 0.1) << static_cast<int>(m.projection) << " k1 " << m.lens.k1;
    }
}

TEST_P(CameraOptics, ColoursAreMagnifiedApart) {
  CameraModel m = small_camera();
  m.chromatic.magnification = {1.02, 1, 0.97};
  const double x = 24 / 80.0 * 3, y = -12 / 80.0 * 3;
  world_.put({0.06F, 1e-3F, 0.06F}, in_front(x, y, 3));
  const OpticsPicture p = shoot(m, fine());
  for (const auto& [band, magnification] : {std::pair{0, 1.02}, {1, 1.0}, {2, 0.97}, {3, 1.02}}) {
    const Spot s = spot(p, band);
    EXPECT_NEAR(s.u, 31.5 + 24 * magnification, 0.05) << band;
    EXPECT_NEAR(s.v, 23.5 - 12 * magnification, 0.05) << band;
  }
}

TEST_P(CameraOptics, ColoursThatAreMovedLieWhereTracedOnesDo) {
  if (!rays()) return;
  // At the sensor's edge too, where red comes from within it and blue from beyond.
  CameraModel m = small_camera();
  m.chromatic.magnification = {1.05, 1, 0.94};
  for (const double right_px : {0.0, 24.0, 27.0, 32.0}) {
    world_ = {};
    world_.put({0.06F, 1e-3F, 0.06F}, in_front(right_px / 80 * 3, -12 / 80.0 * 3, 3));
    OpticsOptions o = fine();
    o.trace_colours = true;
    const OpticsPicture traced = shoot(m, o);
    o.trace_colours = false;
    const OpticsPicture moved = shoot(m, o);
    for (int band = 0; band < 4; ++band) {
      if (right_px > 30 && band != 2) continue;  // beside the sensor
      const Spot a = spot(traced, band), b = spot(moved, band);
      ASSERT_GT(a.sum, 1);
      EXPECT_NEAR(b.u, a.u, 0.06) << band << " " << right_px;
      EXPECT_NEAR(b.v, a.v, 0.06) << band << " " << right_px;
      EXPECT_NEAR(b.sum, a.sum, 0.04 * a.sum) << band << " " << right_px;
    }
  }
}

TEST_P(CameraOptics, ACoarsePictureHasItsLightInTheSamePlaces) {
  if (!rays()) return;
  CameraModel m = distorted();
  m.chromatic.magnification = {1.02, 1, 0.97};
  world_.put({0.15F, 1e-3F, 0.15F}, in_front(0.5, -0.3, 3));
  const OpticsPicture whole = shoot(m, fine());
  for (const int step : {2, 3}) {
    OpticsOptions o = fine();
    o.pixel_step = step;
    const OpticsPicture coarse = shoot(m, o);
    ASSERT_EQ(coarse.radiance.size(), whole.radiance.size());
    for (int band = 0; band < 4; ++band) {
      const Spot a = spot(whole, band), b = spot(coarse, band);
      EXPECT_NEAR(b.u, a.u, 0.1) << band << " " << step;
      EXPECT_NEAR(b.v, a.v, 0.1) << band << " " << step;
      EXPECT_NEAR(b.sum, a.sum, 0.03 * a.sum) << band << " " << step;
    }
    OpticsRequest part;
    part.region = {37, 11, 20, 15};
    const OpticsPicture cut = shoot(m, o, part);
    for (int v = 0; v < 15; ++v)
      for (int u = 0; u < 20; ++u)
        for (int band = 0; band < 4; ++band)
          ASSERT_EQ(at(cut, u, v, band), at(coarse, u + 37, v + 11, band)) << u << " " << v << " " << band;
  }
  OpticsOptions o = fine();
  o.pixel_step = 9;
  EXPECT_FALSE(make_rays_optics(m, o, std::shared_ptr<render::EmbreeCache>()));
}

/// Puts the right edge of a wide plate into the column right of the middle, of which it covers this share: a
/// sharp edge then has the variance that pixels give a smooth one, 1/12 for their width and 1/12 for the
/// difference of two.
constexpr double kShare = 0.21132;  // share (1 - share) = 1/6
Eigen::Vector3d edge_at(const CameraModel& m, double depth) {
  return in_front(kShare * depth / m.fx_px - 5, 0, depth);
}
/// Of the line spread function of that edge: its place, and its variance without the pixels' part.
struct Edge {
  double mean, variance;
};
Edge edge_of(const OpticsPicture& p, int band = 0) {
  double sum = 0, first = 0, second = 0;
  for (int v = 12; v < 36; ++v)
    for (int u = 0; u + 1 < p.width_px; ++u) {
      const auto at = [&](int x) {
        return static_cast<double>(
            p.radiance[4 * static_cast<std::size_t>(v * p.width_px + x) + static_cast<std::size_t>(band)]);
      };
      const double step = at(u) - at(u + 1);
      sum += step;
      first += step * u;
      second += step * u * u;
    }
  const double mean = first / sum;
  return {mean, second / sum - mean * mean - 1.0 / 6};
}

// A uniform disc of diameter D spreads a line by a variance of D²/16.
TEST_P(CameraOptics, AnEdgeOutOfFocusIsAsWideAsTheDiscOfItsDepth) {
  CameraModel m = small_camera(120);
  m.optics.f_number = 2;
  m.optics.pixel_pitch_m = 20e-6;
  m.depth_of_field.focal_length_m = 0.025;
  for (const auto& [focus_m, depth_m] : {std::pair{2.0, 4.0}, {2.0, 1.4}, {3.0, 30.0}}) {
    m.depth_of_field.focus_distance_m = focus_m;
    world_ = {};
    world_.put({5, 1e-3F, 5}, edge_at(m, depth_m));
    const double wanted = blur_diameter_px(m, depth_m);
    ASSERT_GT(wanted, 2.5);
    const double variance = edge_of(shoot(m, fine())).variance;
    EXPECT_NEAR(4 * std::sqrt(variance), wanted, 0.1 * wanted) << focus_m << " " << depth_m;
  }
  m.depth_of_field.focus_distance_m = 2;
  world_ = {};
  world_.put({5, 1e-3F, 5}, edge_at(m, 2));
  EXPECT_LT(edge_of(shoot(m, fine())).variance, 0.1) << "in focus";
}

TEST_P(CameraOptics, WhatIsNearAndBlurredLiesOverWhatIsSharpBehindIt) {
  CameraModel m = small_camera(120);
  m.optics.pixel_pitch_m = 20e-6;
  m.optics.f_number = 2;
  m.depth_of_field = {.focus_distance_m = 4, .focal_length_m = 0.025};
  world_.put({9, 1e-3F, 9}, in_front(0, 0, 4), 0.5F);
  world_.put({5, 1e-3F, 5}, edge_at(m, 1.6), 1.0F);
  world_.light().light.sun_angular_radius_rad = 0.001F;
  OpticsOptions o = fine();
  o.shadows = false;
  const OpticsPicture p = shoot(m, o);
  const double wanted = blur_diameter_px(m, 1.6);
  EXPECT_NEAR(4 * std::sqrt(edge_of(p).variance), wanted, 0.1 * wanted);
  // What of the disc lies beyond the edge covers what is behind; seen to catch layers that are merely
  // averaged.
  const double t = (33 - 31.5 - kShare) / (0.5 * wanted);
  const double covered = (std::acos(t) - t * std::sqrt(1 - t * t)) / std::numbers::pi;
  EXPECT_NEAR(at(p, 33, 24), 0.5 + 0.5 * covered, 0.015);
  // The edge of something sharp before something blurred stays sharp.
  m.depth_of_field.focus_distance_m = 1.6;
  EXPECT_LT(edge_of(shoot(m, o)).variance, 0.15);
}

TEST_P(CameraOptics, ColoursFocusApart) {
  CameraModel m = small_camera(120);
  m.optics.pixel_pitch_m = 20e-6;
  m.optics.f_number = 2;
  m.depth_of_field = {.focus_distance_m = 2, .focal_length_m = 0.025};
  m.chromatic.focus_shift_m = {0.8, 0, -0.5};
  world_.put({5, 1e-3F, 5}, edge_at(m, 2));
  const OpticsPicture p = shoot(m, fine());
  EXPECT_LT(edge_of(p, 1).variance, 0.1);
  for (const int c : {0, 2}) {
    const double wanted = blur_diameter_px(m, 2, c);
    ASSERT_GT(wanted, 2);
    EXPECT_NEAR(4 * std::sqrt(edge_of(p, c).variance), wanted, 0.12 * wanted) << c;
  }
}

TEST_P(CameraOptics, APixelThatNoRayReachesIsDark) {
  CameraModel m = small_camera(22);
  m.lens.k1 = -0.5;  // folds within the picture
  ASSERT_FALSE(unproject_ray(m, {0, 0}));
  world_.light().light.sky = even_sky(0.5F);
  world_.light().light.ground_albedo = grey(0.5F);
  const OpticsPicture p = shoot(m, plain());
  EXPECT_EQ(at(p, 0, 0), 0.0F);
  EXPECT_GT(at(p, 31, 16), 0.2F);
}

}  // namespace
}  // namespace rigor::test
