// Light in the simulator's pixels: edges, motion, several ways, the sun, gloss and retro-reflectors.
#include "tests/sim/sensors/tof/tof_fixture.h"

namespace rigor::test {
namespace {

using models::TofModel;

TEST(FlyingPixels, MixPhasorsByTheCoveredShareAndOnlyAtTheEdge) {
  TofModel m = perfect(9, 200, 20000);
  m.sampling.samples = 16;
  const double e_near = m.active_electrons(kNear_m, 0.4), e_far = m.active_electrons(kFar_m, 0.8);
  double largest_gap_to_ranges = 0;
  for (const double share : {0.1, 0.25, 0.4, 0.5, 0.62, 0.75, 0.93}) {
    TofBench b;
    step_at(b, m, 3.5 + share);  // pixel 4 spans 3.5 to 4.5
    const TofPicture p = b.shoot(m, 0, true);
    double sum = 0;
    for (int v = 0; v < 200; ++v) {
      for (int u = 0; u < 9; ++u)
        if (u != 4) {
          ASSERT_NEAR(p.range_m[size_t(v * 9 + u)], u < 4 ? kNear_m : kFar_m, 2e-3) << u;
        }
      const std::size_t i = size_t(v * 9 + 4);
      const double e = (double(p.taps[4 * i]) + double(p.taps[4 * i + 1]) + double(p.taps[4 * i + 2]) +
                        double(p.taps[4 * i + 3])) /
                       2;
      const double covered = (e - e_far) / (e_near - e_far);
      const auto mixed =
          covered * phasor_of(e_near, kNear_m, 30e6) + (1 - covered) * phasor_of(e_far, kFar_m, 30e6);
      ASSERT_NEAR(p.range_m[i], range_of(mixed, 30e6), 2e-3);
      ASSERT_NEAR(p.amplitude[i], std::abs(mixed) / 4, 1e-3 * e);
      ASSERT_NEAR(covered * 16, std::round(covered * 16), 0.05);  // sixteenths
      sum += covered;
      largest_gap_to_ranges =
          std::max(largest_gap_to_ranges,
                   std::abs(range_of(mixed, 30e6) - (covered * kNear_m + (1 - covered) * kFar_m)));
    }
    // In each of 4 x 4 cells one sample: of the cells on the edge, each is in front with the share of its
    // cell.
    const double cell = share * 4 - std::floor(share * 4);
    const double sigma = std::sqrt(4 * cell * (1 - cell)) / 16 / std::sqrt(200.0);
    EXPECT_NEAR(sum / 200, share, 4 * sigma + 1e-3) << share;
  }
  EXPECT_GT(largest_gap_to_ranges, 0.1);  // a mean of ranges would be something else
}

TEST(FlyingPixels, BilinearSamplesAreSharedBetweenNeighbours) {
  // One sample a pixel and side, light between them bilinear: of a step between pixels 3 and 4 each of the
  // two takes an eighth from the other.
  TofModel m = perfect(9, 5, 20000);
  m.sampling.bilinear = true;
  TofBench b;
  step_at(b, m, 3.5);
  const double e_near = m.active_electrons(kNear_m, 0.4), e_far = m.active_electrons(kFar_m, 0.8);
  const auto near_light = phasor_of(e_near, kNear_m, 30e6), far_light = phasor_of(e_far, kFar_m, 30e6);
  b.engine->rays_cast = 0;
  const TofPicture p = b.shoot(m);
  EXPECT_EQ(b.engine->rays_cast, 11u * 7u);  // a margin of one all round
  for (int v = 0; v < 5; ++v)
    for (int u = 0; u < 9; ++u) {
      const double share = u < 3 ? 1 : u == 3 ? 0.875 : u == 4 ? 0.125 : 0;
      ASSERT_NEAR(p.range_m[size_t(v * 9 + u)], range_of(share * near_light + (1 - share) * far_light, 30e6),
                  1e-4)
          << u;
    }
  // Two on a side: a step through the middle of pixel 4; its own four samples, and next to them those whose
  // hats reach into it with a sixteenth of a row.
  m.sampling.samples = 4;
  TofBench c;
  step_at(c, m, 4.0);
  const TofPicture q = c.shoot(m);
  for (int u = 0; u < 9; ++u) {
    const double share = u < 4 ? 1 : u == 4 ? 0.5 : 0;
    EXPECT_NEAR(q.range_m[size_t(2 * 9 + u)], range_of(share * near_light + (1 - share) * far_light, 30e6),
                1e-4)
        << u;
  }
  c.engine->clear();
  step_at(c, m, 4.5);
  const TofPicture r = c.shoot(m);
  for (const auto& [u, share] : {std::pair{4, 15.0 / 16}, {5, 1.0 / 16}})
    EXPECT_NEAR(r.range_m[size_t(2 * 9 + u)], range_of(share * near_light + (1 - share) * far_light, 30e6),
                1e-4);
}

/// A row of pixels before a wall at kFar_m, a near sheet whose right edge goes by at `speed_px` pixels
/// a tap.
struct MovingEdge {
  TofModel m = perfect(41, 1, 2000);
  TofBench b;
  double step_s = 0;
  explicit MovingEdge(double px_per_tap, models::TofTaps taps = models::TofTaps::single) {
    m.sampling.motion = true;
    m.modulation.taps = taps;
    m.modulation.tap_window_s = 0.04;
    step_s = 0.04 / m.exposures();
    b.wall(kFar_m, 0.8F);
    b.engine->add(Rectangle{.centre = {-5, 0, kNear_m}, .half_u = {5, 0, 0}, .half_v = {0, 5, 0}},
                  {.reflectance = grey(0.4F),
                   .velocity_m_per_s = {px_per_tap / step_s / m.fx_px * kNear_m, 0, 0},
                   .t_ref = b.t});
    b.world.moves = true;
  }
  /// Does the pixel see the sheet in exposure m?
  [[nodiscard]] bool near_at(int u, int exposure, double px_per_tap) const {
    const double edge = m.cx_px + px_per_tap * (exposure - (m.exposures() - 1) / 2.0);
    return u < edge;
  }
};

TEST(MotionArtefacts, OfAMovingEdgeAreThoseOfTapsThatSeeDifferentThings) {
  for (const double speed : {3.1, -3.1}) {
    MovingEdge e(speed);
    const TofPicture p = e.b.shoot(e.m);
    int mixed = 0;
    for (int u = 0; u < 41; ++u) {
      double d[4];
      int near_taps = 0;
      for (int k = 0; k < 4; ++k) {
        const bool near = e.near_at(u, k, speed);
        near_taps += near;
        const double range = (near ? kNear_m : kFar_m) / axis_cosine(e.m, u, 0);
        const double c = axis_cosine(e.m, u, 0);
        const double el = e.m.active_electrons(range, near ? 0.4 : 0.8) * c;
        d[k] = el / 2 * (1 + 0.5 * std::cos(2 * kPi * turns_of(range, 30e6) + k * kPi / 2));
      }
      const double expected = range_of({d[0] - d[2], d[3] - d[1]}, 30e6);
      ASSERT_NEAR(p.range_m[size_t(u)], expected, 1e-4) << u;
      if (near_taps % 4 != 0) ++mixed;
    }
    EXPECT_EQ(mixed, 9) << speed;  // three steps between four taps, 3.1 pixels each
  }
  // The sign: pixel 20, the middle, has its first two taps from the far wall (187 degrees) and the others
  // from the brighter sheet (101 degrees) where the edge comes: D0 < D2 and D1 < D3 by the means too,
  // which draws the phase towards 135 degrees. Where it goes, the means draw to -45 degrees: nearer than
  // both.
  MovingEdge coming(3.1), going(-3.1);
  EXPECT_NEAR(coming.b.shoot(coming.m).range_m[20], 1.84, 0.02);
  EXPECT_NEAR(going.b.shoot(going.m).range_m[20], 0.57, 0.05);
}

TEST(MotionArtefacts, DifferentialTapsHaveTwoInstants) {
  MovingEdge e(4.2, models::TofTaps::differential);
  e.b.engine->rays_cast = 0;
  const TofPicture p = e.b.shoot(e.m);
  EXPECT_EQ(e.b.engine->rays_cast, 2u * 41u);
  for (int u = 0; u < 41; ++u) {
    double d[4];
    for (int k = 0; k < 4; ++k) {
      const bool near = e.near_at(u, k % 2, 4.2);
      const double c = axis_cosine(e.m, u, 0), range = (near ? kNear_m : kFar_m) / c;
      d[k] = e.m.active_electrons(range, near ? 0.4 : 0.8) * c / 2 *
             (1 + 0.5 * std::cos(2 * kPi * turns_of(range, 30e6) + k * kPi / 2));
    }
    ASSERT_NEAR(p.range_m[size_t(u)], range_of({d[0] - d[2], d[3] - d[1]}, 30e6), 1e-4) << u;
  }
}

TEST(MotionArtefacts, OfASensorThatApproachesAWall) {
  TofModel m = perfect(1, 1, 100);
  m.sampling.motion = true;
  m.modulation.tap_window_s = 0.05;
  TofBench b;
  b.wall(3.0);
  const double speed = 4;
  b.pose = [&](BenchTime t) {
    Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
    pose.translation().z() = speed * (t - b.t).seconds();
    return pose;
  };
  double d[4];
  for (int k = 0; k < 4; ++k) {
    const double range = 3 - speed * (k - 1.5) * 0.05 / 4;
    d[k] = m.active_electrons(range, 0.8) / 2 *
           (1 + 0.5 * std::cos(2 * kPi * turns_of(range, 30e6) + k * kPi / 2));
  }
  const double expected = range_of({d[0] - d[2], d[3] - d[1]}, 30e6);
  EXPECT_GT(std::abs(expected - 3), 0.01);
  EXPECT_NEAR(b.shoot(m).range_m[0], expected, 1e-5);
}

TEST(MotionArtefacts, WhatStandsStillIsCastOnce) {
  TofModel m = perfect(10, 10, 20);
  m.sampling.motion = true;
  m.modulation.tap_window_s = 0.04;
  TofBench b;
  b.wall(2);
  (void)b.shoot(m);
  EXPECT_EQ(b.engine->rays_cast, 100u);
  b.world.moves = true;
  b.engine->rays_cast = 0;
  (void)b.shoot(m);
  EXPECT_EQ(b.engine->rays_cast, 400u);
  EXPECT_EQ(b.world.asked_instants, 4);
  m.sampling.motion = false;
  b.engine->rays_cast = 0;
  (void)b.shoot(m);
  EXPECT_EQ(b.engine->rays_cast, 100u);
}

TEST(Multipath, InsideABallIsItsClosedForm) {
  // From the centre of a ball of radius r, every point sends ρ times the direct light on to every other, over
  // chords 2 r cos β with Lambert's weight 2 cos β sin β: Σ E = (1 + ρ) E₀ and
  // phasor = E₀ e^{iar} (1 + ρ ∫₀¹ 2 t e^{iart} dt), a = 4 pi f/c.
  const double r = 1.5, rho = 0.6, a = 4 * kPi * 30e6 / kLightSpeed_mps;
  TofBench b;
  b.engine->add(Sphere{.centre = {0, 0, 0}, .radius_m = r}, {.reflectance = grey(0.6F)});
  TofModel m = perfect(16, 16, 16);
  m.sampling.multipath_rays = 64;
  const TofPicture p = b.shoot(m, 0, true);
  // The light shines forwards only: points of the rear half are dark. A chord from the axis ends there for
  // cos β < 1/√2; in general the sensor's pixels see it so within the tolerance of an integral per pixel.
  const double e0 = m.active_electrons(r, rho);
  const std::size_t i = 8 * 16 + 8;
  // Chords that end in the front half: for the axis' own point t = cos β from 0 to 1/√2.
  std::complex<double> sum = 0;
  double share = 0;
  for (int k = 0; k < 20000; ++k) {
    const double t = (k + 0.5) / 20000 * std::sqrt(0.5);
    sum += 2 * t * std::polar(1.0, a * r * t) * (std::sqrt(0.5) / 20000);
    share += 2 * t * (std::sqrt(0.5) / 20000);
  }
  EXPECT_NEAR(share, 0.5, 1e-6);
  const auto mixed = std::polar(e0, a * r) * (1.0 + rho * sum);
  double taps = 0;
  for (std::size_t k = 0; k < 4; ++k) taps += double(p.taps[4 * i + k]);
  EXPECT_NEAR(taps / 2, e0 * (1 + rho * 0.5), 0.03 * e0);
  EXPECT_NEAR(p.range_m[i], range_of(mixed, 30e6), 0.02);
  EXPECT_GT(p.range_m[i], 1.6F);
  // Without the option, none of it and no ray more.
  m.sampling.multipath_rays = 0;
  b.engine->rays_cast = 0;
  EXPECT_NEAR(b.shoot(m).range_m[i], r, 1e-5);
  EXPECT_EQ(b.engine->rays_cast, 256u);
}

TEST(Multipath, DoesNotComeFromWhatTheLightDoesNotReach) {
  // A wall ahead and a side wall that a screen hides from the camera: its light would add to the taps.
  TofModel m = perfect(3, 3, 1000);
  m.sampling.multipath_rays = 64;
  const auto light = [&](bool screen) {
    TofBench b;
    b.wall(2.0);
    b.engine->add(Rectangle{.centre = {0.5, 0, 1.5}, .half_u = {0, 0, 0.4}, .half_v = {0, 3, 0}},
                  {.reflectance = grey(0.9F)});
    if (screen)
      b.engine->add(Rectangle{.centre = {0.25, 0, 0.5}, .half_u = {0.24, 0, 0}, .half_v = {0, 3, 0}},
                    {.reflectance = grey(0.0F)});
    const TofPicture p = b.shoot(m, 0, true);
    return double(p.taps[16] + p.taps[17] + p.taps[18] + p.taps[19]);
  };
  TofBench alone;
  alone.wall(2.0);
  const TofPicture p = alone.shoot(m, 0, true);
  const double none = double(p.taps[16] + p.taps[17] + p.taps[18] + p.taps[19]);
  EXPECT_GT(light(false), none * 1.02);
  EXPECT_NEAR(light(true), none, none * 1e-5);
}

TEST(AmbientLight, OfTheSunOnASurfaceIsItsClosedForm) {
  TofModel m = perfect(3, 3, 1000);
  m.optics.filter_width_m = 20e-9;
  const double dark = m.active_electrons(2, 0.5) / 2;
  // The sun must stand above the horizon (world z), so the wall is the ground seen from above.
  TofBench g;
  g.pose = [](BenchTime) {
    Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
    pose.linear() = Eigen::AngleAxisd(kPi, Eigen::Vector3d::UnitX()).toRotationMatrix();  // looks down
    pose.translation().z() = 2;
    return pose;
  };
  g.engine->add(Plane{}, {.reflectance = grey(0.5F)});
  auto& light = g.world.still.frame.light;
  light.direction_to_sun = {0.6, 0, 0.8};
  light.sun_irradiance = grey(40);
  const auto taps = [&](TofBench& bench) {
    const TofPicture p = bench.shoot(m, 0, true);
    return double(p.taps[16] + p.taps[17] + p.taps[18] + p.taps[19]) / 4;
  };
  // Radiance 0.5/π · 40 · 0.8, of which the filter lets 20 of the band's 50 nm in, half of it to a tap.
  const double expected = m.electrons_per_radiance() * 0.5 / kPi * 40 * 0.8 * 0.4 / 2;
  EXPECT_NEAR(taps(g) - dark, expected, 1e-4 * (expected + dark));
  // A screen between the ground and the sun.
  g.engine->add(Sphere{.centre = {1.2, 0, 1.6}, .radius_m = 0.3}, {.reflectance = grey(0)});
  EXPECT_NEAR(taps(g), dark, 1e-4 * dark);
  m.sampling.sun_shadows = false;
  EXPECT_NEAR(taps(g) - dark, expected, 1e-4 * (expected + dark));
  // Without a filter's width there is none, and nothing is asked.
  m.optics.filter_width_m = 0;
  m.sampling.sun_shadows = true;
  g.engine->rays_cast = 0;
  EXPECT_NEAR(taps(g), dark, 1e-4 * dark);
  EXPECT_EQ(g.engine->rays_cast, 9u);
}

TEST(AmbientLight, BlindsAndIsSuppressedButKeepsItsNoise) {
  TofBench g;
  g.pose = [](BenchTime) {
    Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
    pose.linear() = Eigen::AngleAxisd(kPi, Eigen::Vector3d::UnitX()).toRotationMatrix();
    pose.translation().z() = 2;
    return pose;
  };
  g.engine->add(Plane{}, {.reflectance = grey(0.5F)});
  auto& light = g.world.still.frame.light;
  light.direction_to_sun = {0, 0, 1};
  TofModel m = perfect(64, 64, 1e6);
  m.sampling.sun_shadows = false;  // the sensor stands in the sun's way to nothing
  m.optics.filter_width_m = 50e-9;
  m.pixel.trembling = true;
  m.illumination.radiant_intensity_w_per_sr = 0.3;
  const double a = m.active_electrons(2, 0.5) / 2;
  const double background = 10 * a;
  light.sun_irradiance = grey(float(background * 2 / (m.electrons_per_radiance() * 0.5 / kPi)));
  m.pixel.full_well_e = 4 * a;
  const TofPicture blind = g.shoot(m);
  for (const auto s : blind.status) ASSERT_EQ(s, TofPixelStatus::saturated);
  for (const float r : blind.range_m) ASSERT_TRUE(std::isnan(r));
  m.pixel.ambient_suppression = 1;
  const TofPicture p = g.shoot(m);
  const Spread s = spread_of(p.range_m);
  EXPECT_EQ(s.count, 4096);
  const double sigma =
      models::TofMath<double>::tof_range_sigma(2 * 30e6 / kLightSpeed_mps, a, background, 0, 0.5);
  EXPECT_NEAR(s.sigma / sigma, 1, chi_bound(4096) + 0.01);
}

TEST(AmbientLight, TheSunInThePictureBlindsThePixelsThatSeeIt) {
  TofBench b;
  TofModel m = perfect(41, 41, 200);
  b.pose = [](BenchTime) {  // looks straight up
    return Eigen::Isometry3d::Identity();
  };
  b.world.still.frame.light.direction_to_sun = {0, 0, 1};
  b.world.still.frame.light.sun_irradiance = grey(40);
  m.optics.filter_width_m = 10e-9;
  m.pixel.full_well_e = 1e5;
  const TofPicture p = b.shoot(m);
  int blind = 0;
  for (int v = 0; v < 41; ++v)
    for (int u = 0; u < 41; ++u) {
      const double angle = std::atan(std::hypot(u - 20, v - 20) / 200);
      const auto s = p.status[size_t(v * 41 + u)];
      blind += s == TofPixelStatus::saturated;
      if (angle < 0.0045) {
        ASSERT_EQ(s, TofPixelStatus::saturated);
      }
      if (angle > 0.006) {
        ASSERT_EQ(s, TofPixelStatus::no_return);
      }
    }
  EXPECT_GE(blind, 1);
}

TEST(AmbientLight, OfTheSunIsNotMissedByPixelsLargerThanIt) {
  TofBench b;
  TofModel m = perfect(21, 21, 50);
  b.world.still.frame.light.sun_irradiance = grey(40);
  m.optics.filter_width_m = 10e-9;
  m.pixel.full_well_e = 1e5;
  m.limits.min_amplitude_e = m.active_electrons(1, 1.0);
  for (int i = 0; i < 80; ++i) {
    m.sampling.samples = i % 2 ? 4 : 16;
    // A far wall beside the sun is too dark to be measured.
    b.engine->clear();
    if (i >= 40)
      b.engine->add(Rectangle{.centre = {0, (5.6 + i % 9 - 10) / 50.0 * 5000 + 5000, 5000},
                              .half_u = {9e3, 0, 0},
                              .half_v = {0, 5e3, 0}});
    const int u = 4 + i % 12, v = 5 + i % 9;
    b.world.still.frame.light.direction_to_sun =
        Eigen::Vector3d((u - 10 + 0.03 * (i % 5)) / 50.0, (v - 10 - 0.04 * (i % 3)) / 50.0, 1).normalized();
    EXPECT_EQ(b.shoot(m).status[size_t(v * 21 + u)], TofPixelStatus::saturated) << i;
  }
}

TEST(TofSimulator, RetroReflectorSaturatesWhereAWhiteWallDoesNot) {
  TofModel m = perfect(3, 3, 1000);
  TofBench white, retro;
  white.wall(2, 0.9F);
  m.pixel.full_well_e = 2 * m.active_electrons(2, 0.9);
  EXPECT_EQ(white.shoot(m).status[4], TofPixelStatus::valid);
  retro.engine->add(Plane{.point = {0, 0, 2}, .normal = {0, 0, -1}},
                    {.reflectance = grey(0.3F), .retro_reflection = 0.5F});
  EXPECT_EQ(retro.shoot(m).status[4], TofPixelStatus::saturated);
}

TEST(TofSimulator, AMaterialThatIsNotANumberReflectsNothing) {
  TofBench b;
  b.engine->add(Plane{.point = {0, 0, 2}, .normal = {0, 0, -1}},
                {.map = [](render::Hit& h, const Eigen::Vector3d& p, int) {
                  if (p.x() > 0) h.reflectance = std::nanf("");
                }});
  TofModel m = perfect(4, 1, 10);
  m.sampling.samples = 4;
  m.optics.filter_width_m = 50e-9;
  const TofPicture p = b.shoot(m);
  for (int u = 0; u < 4; ++u) {
    EXPECT_EQ(p.status[size_t(u)], u < 2 ? TofPixelStatus::valid : TofPixelStatus::no_return);
    EXPECT_TRUE(std::isfinite(p.amplitude[size_t(u)]));
  }
}

TEST(TofSimulator, AirTakesLightThereAndBack) {
  TofBench b;
  b.wall(4);
  const TofModel m = perfect(1, 1, 100);
  const double clear = double(b.shoot(m).amplitude[0]);
  b.world.still.frame.hazes.push_back({.extinction_per_m = grey(0.05F)});
  EXPECT_NEAR(double(b.shoot(m).amplitude[0]) / clear, std::exp(-2 * 0.05 * 4), 1e-5);
}

}  // namespace
}  // namespace rigor::test
