// Which rays a time-of-flight camera casts: samples that instants share, pixels that one sample stands for.
#include "tests/sim/sensors/tof/tof_fixture.h"

namespace rigor::test {
namespace {

using models::TofModel;

/// Four samples a pixel and four instants, of a sensor that moves at a speed.
struct MovingSensor {
  static constexpr world::NodeId kBall{7};
  TofModel m = perfect(40, 30, 100);
  TofBench b;
  explicit MovingSensor(const Eigen::Vector3d& speed_mps) {
    m.sampling = {.samples = 4, .motion = true};
    m.modulation.tap_window_s = 0.04;
    b.pose = [this, speed_mps](BenchTime t) {
      Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
      pose.translation() = speed_mps * (t - b.t).seconds();
      return pose;
    };
  }
  /// By casting all samples at each instant: what a world whose batches all move leads to.
  TofPicture in_full() {
    b.world.moves = true;
    b.world.moving_nodes = {{}, kBall};
    TofPicture p = b.shoot(m);
    b.world.moves = false;
    return p;
  }
};

TEST(SharedSamples, OfASensorThatMovesAreCastOnce) {
  MovingSensor c({0, 0, 2});
  c.b.wall(2);
  c.b.engine->rays_cast = 0;
  const TofPicture p = c.b.shoot(c.m);
  // Plain pixels have one; those at the border of the picture all four, at other instants too where what lies
  // there was not met before.
  EXPECT_LT(c.b.engine->rays_cast, 1200u + 3u * 4u * 136u);
  const TofPicture full = c.in_full();
  double squares = 0;
  for (std::size_t i = 0; i < p.range_m.size(); ++i)
    squares += std::pow(static_cast<double>(p.range_m[i] - full.range_m[i]), 2);
  // Samples of a pixel of a wall square to the axis lie some millimetres apart.
  EXPECT_LT(std::sqrt(squares / 1200), 0.001);
  // Not because nothing happened: a tap of the approach counts 20 mm.
  c.m.sampling.motion = false;
  EXPECT_GT(std::abs(c.b.shoot(c.m).range_m[620] - full.range_m[620]), 0.003F);
}

TEST(SharedSamples, AreTakenInEqualPartsByTheTapsOfAnObliqueWall) {
  // A third of a pixel a tap, sideways before a wall at 60 degrees: each tap of a pixel has the wall at one
  // range more, and where the pixel is stays the same. A sample that changed pixels as a whole would show as
  // an error of up to a pixel's step along the wall, 35 mm. A sensor that recedes sees more and more of it,
  // so that what was met overlaps.
  const Eigen::Vector3d n(std::sin(1.05), 0, -std::cos(1.05));
  for (const Eigen::Vector3d& speed_mps : {Eigen::Vector3d(0.667, 0, 0), Eigen::Vector3d(0, 0, -4)})
    for (const int samples : {1, 4}) {
      MovingSensor c(speed_mps);
      c.m.sampling.samples = samples;
      c.b.engine->add(Plane{.point = {0, 0, 2}, .normal = n}, {.reflectance = grey(0.8F)});
      const TofPicture p = c.b.shoot(c.m);
      double worst = 0;
      for (int v = 2; v < 28; ++v)
        for (int u = 0; u < 40; ++u) {
          if (samples > 1 && (u < 2 || u > 37)) continue;  // those have jittered samples
          double d[4];
          for (int k = 0; k < 4; ++k) {
            const Eigen::Vector3d eye = speed_mps * (k - 1.5) * 0.01;
            const Eigen::Vector3d way =
                Eigen::Vector3d((u - c.m.cx_px) / 100, (v - c.m.cy_px) / 100, 1).normalized();
            const double range = n.dot(Eigen::Vector3d(0, 0, 2) - eye) / n.dot(way);
            const double e = c.m.active_electrons(range, 0.8) * -n.dot(way);
            d[k] = tap_of(e, range, k);
          }
          worst = std::max(worst, std::abs(double(p.range_m[size_t(v * 40 + u)]) -
                                           range_of({d[0] - d[2], d[3] - d[1]}, 30e6)));
        }
      EXPECT_LT(worst, 0.002) << speed_mps.transpose() << ", " << samples;
    }
}

TEST(SharedSamples, OfASensorThatTurnsFastLackNowhere) {
  // Six pixels a tap: what comes in at the border was not met at the instant in the middle.
  MovingSensor c({0, 0, 0});
  c.b.wall(2);
  c.b.pose = [&c](BenchTime t) {
    Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
    pose.linear() = Eigen::AngleAxisd(6 * (t - c.b.t).seconds(), Eigen::Vector3d::UnitY()).toRotationMatrix();
    return pose;
  };
  for (const int samples : {1, 4}) {
    c.m.sampling.samples = samples;
    const TofPicture p = c.b.shoot(c.m), full = c.in_full();
    for (std::size_t i = 0; i < p.range_m.size(); ++i)
      ASSERT_NEAR(p.range_m[i], full.range_m[i], 0.02) << i << ", " << samples;
  }
}

/// Of each pixel and tap, the share of the near sheet of step_at(…, 19.5) that a sensor at a speed to the
/// side measures, as a mean over rows, less that which it should.
double worst_share_error(double speed_mps, float near_reflectance) {
  MovingSensor c({speed_mps, 0, 0});
  c.m.sampling.samples = 16;
  step_at(c.b, c.m, 19.5, near_reflectance);
  const auto camera = c.b.camera(c.m);
  const TofPicture p = c.b.shoot(*camera, 0, nullptr, true);
  const double e_near = c.m.active_electrons(kNear_m, near_reflectance),
               e_far = c.m.active_electrons(kFar_m, 0.8);
  double worst = 0;
  for (int u = 12; u < 28; ++u)
    for (int tap = 0; tap < 4; ++tap) {
      double mean = 0;
      for (int v = 5; v < 25; ++v)
        mean += double(p.taps[static_cast<std::size_t>(4 * (v * 40 + u) + tap)]) / 20;
      const double edge = 19.5 - speed_mps * (tap - 1.5) * 0.01 / kNear_m * 100;
      const double covered = std::clamp(edge - (u - 0.5), 0.0, 1.0);
      const double near_tap = tap_of(e_near, kNear_m, tap), far_tap = tap_of(e_far, kFar_m, tap);
      worst = std::max(worst, std::abs((mean - far_tap) / (near_tap - far_tap) - covered));
    }
  return worst;
}

TEST(SharedSamples, OfWhatIsNearerHideWhatIsFarther) {
  // A near sheet before a wall: in the pixel that its edge crosses the sheet has what it covers, and the wall
  // the rest, be it that the wall is hidden or that it comes out behind the edge. Of a black sheet too.
  for (const double speed_mps : {0.467, -0.467, 1.3, -1.3, 2.3, -2.3})
    for (const float reflectance : {0.4F, 0.8F, 0.0F})
      EXPECT_LT(worst_share_error(speed_mps, reflectance), 0.15) << speed_mps << ", " << reflectance;
}

/// A sensor that looks down on ground in the sun from 2 m and turns by six pixels a tap.
struct TurningOverSunlitGround : MovingSensor {
  TurningOverSunlitGround() : MovingSensor({0, 0, 0}) {
    m.optics.filter_width_m = 50e-9;
    m.illumination.radiant_intensity_w_per_sr = 1e-6;
    b.pose = [this](BenchTime t) {
      Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
      pose.linear() = (Eigen::AngleAxisd(kPi, Eigen::Vector3d::UnitX()) *
                       Eigen::AngleAxisd(6 * (t - b.t).seconds(), Eigen::Vector3d::UnitY()))
                          .toRotationMatrix();
      pose.translation().z() = 2;
      return pose;
    };
    b.world.still.frame.light.direction_to_sun = {0, 0, 1};
    b.world.still.frame.light.sun_irradiance = grey(40);
  }
  /// A screen above the ground, so wide to both sides of x.
  void screen(double x, double half_width) {
    b.engine->add(Rectangle{.centre = {x, 0, 2.5}, .half_u = {half_width, 0, 0}, .half_v = {0, 3, 0}});
  }
  /// f(tap, the same tap with all samples cast at each instant) of pixels in columns `us`.
  template <class F>
  void compare(std::initializer_list<int> us, const F& f) {
    const auto camera = b.camera(m);
    const TofPicture p = b.shoot(*camera, 0, nullptr, true);
    b.world.moves = true;
    const TofPicture full = b.shoot(*camera, 0, nullptr, true);
    for (int v = 2; v < 28; ++v)
      for (const int u : us)
        for (std::size_t tap = 0; tap < 4; ++tap) {
          const std::size_t i = 4 * static_cast<std::size_t>(v * 40 + u) + tap;
          f(p.taps[i], full.taps[i]);
        }
  }
};

TEST(SharedSamples, AreInTheShadeThatTheyAreInNow) {
  // A strip in the shade lies beyond the picture's border: it comes in at the last tap and must be dark then.
  TurningOverSunlitGround c;
  c.b.engine->add(Plane{}, {.reflectance = grey(0.5F)});
  c.screen(0.60, 0.12);
  float least = 1e30F, most = 0;
  c.compare({0, 1, 2, 37, 38, 39}, [&](float mine, float full) {
    least = std::min(least, full), most = std::max(most, full);
    EXPECT_NEAR(mine, full, 0.3F * most);
  });
  EXPECT_LT(least, 0.1F * most);  // the shade does come in
}

TEST(SharedSamples, AreInTheSunWhereTheOthersWereInTheShade) {
  // The middle of the picture lies in the shade. What comes in lies in the sun, with stripes of half a pixel
  // that are turned away from it: a pixel whose first sample meets one asks for no shade.
  TurningOverSunlitGround c;
  c.b.engine->add(Plane{},
                  {.reflectance = grey(0.5F), .map = [](render::Hit& hit, const Eigen::Vector3d& p, int) {
                     if (std::abs(p.x()) < 0.45 || std::fmod(std::abs(p.x()), 0.02) < 0.01) return;
                     hit.normal[0] = 1, hit.normal[1] = hit.normal[2] = 0;
                   }});
  c.screen(0, 0.45);
  double mine_sum = 0, full_sum = 0;
  c.compare({0, 1, 38, 39}, [&](float mine, float full) {
    mine_sum += static_cast<double>(mine), full_sum += static_cast<double>(full);
  });
  EXPECT_GT(full_sum, 0);
  EXPECT_NEAR(mine_sum / full_sum, 1, 0.02);
}

TEST(SharedSamples, OfSeveralFrequenciesFindWhatMovesAtTheLastTaps) {
  // The ball comes into the picture at the last two of twelve.
  MovingSensor c({0, 0, 0});
  c.m.modulation.frequencies_hz = {20e6, 30e6, 40e6};
  c.m.modulation.tap_window_s = 0.06;
  c.b.wall(3);
  c.b.engine->add(Sphere{.centre = {-0.85, 0, 2}, .radius_m = 0.06},
                  {.node = c.kBall, .velocity_m_per_s = {20, 0, 0}, .t_ref = c.b.t});
  const TofPicture full = c.in_full();
  c.b.world.moving_nodes = {c.kBall};
  c.b.world.moves = true;
  const TofPicture p = c.b.shoot(c.m);
  for (std::size_t i = 0; i < p.range_m.size(); ++i)
    ASSERT_NEAR(p.amplitude[i] / full.amplitude[i], 1, 0.003) << i;
}

TEST(SharedSamples, ComeBackInThePixelThatSeesThemThen) {
  // Two pixels a tap to the right, before a sheet whose left half alone reflects: the taps of a pixel have
  // the edge of that at four places.
  MovingSensor c({4, 0, 0});
  c.b.engine->add(Plane{.point = {0, 0, 2}, .normal = {0, 0, -1}},
                  {.reflectance = grey(0.8F), .map = [](render::Hit& hit, const Eigen::Vector3d& p, int) {
                     if (p.x() > 0) hit.reflectance = 0.2F;
                   }});
  const auto camera = c.b.camera(c.m);
  const TofPicture p = c.b.shoot(*camera, 0, nullptr, true);
  for (int u = 0; u < 40; ++u)
    for (int tap = 0; tap < 4; ++tap) {
      // Where the edge is: 19.5 px at the middle instant.
      const double edge = 19.5 - 2 * (tap - 1.5), left = std::clamp(edge - (u - 0.5), 0.0, 1.0);
      const double c_axis = axis_cosine(c.m, u, 15), range = 2 / c_axis;
      const double e = c.m.active_electrons(range, 0.2 + 0.6 * left) * c_axis;
      const double expected = tap_of(e, range, tap);
      const bool at_edge = left > 0 && left < 1;
      // At the edge four to sixteen samples say which share is bright.
      const double within = (at_edge || std::abs(edge - u) < 1 ? 0.5 : 0.02) * expected;
      EXPECT_NEAR(p.taps[static_cast<std::size_t>(4 * (15 * 40 + u) + tap)], expected, within)
          << u << ", tap " << tap;
    }
}

TEST(SharedSamples, WhereSomethingMovesAllAreCast) {
  // A ball goes by; what is beside it is shared. The sensor stands still, so that sharing is exact.
  MovingSensor c({0, 0, 0});
  c.b.wall(3);
  c.b.engine->add(Sphere{.centre = {0, 0, 2}, .radius_m = 0.1},
                  {.node = c.kBall, .velocity_m_per_s = {1, 0, 0}, .t_ref = c.b.t});
  const TofPicture full = c.in_full();
  c.b.world.moving_nodes = {c.kBall};
  c.b.world.moves = true;
  c.b.engine->rays_cast = 0;
  const TofPicture p = c.b.shoot(c.m);
  EXPECT_GT(c.b.engine->rays_cast, 1200u + 12u * 80u);
  EXPECT_LT(c.b.engine->rays_cast, 2u * 1200u + 4u * 140u + 16u * 250u);
  int same = 0;
  for (std::size_t i = 0; i < p.range_m.size(); ++i) {
    // Elsewhere plain pixels have the range of their middle, and the others the mean of four samples.
    ASSERT_NEAR(p.range_m[i], full.range_m[i], 0.002) << i;
    same += p.range_m[i] == full.range_m[i];
  }
  EXPECT_GT(same, 80);
}

TEST(SharedSamples, FindWhatMovesFarBetweenTaps) {
  // A ball of six pixels that moves by ten from tap to tap: at the first tap it is where nothing moves in the
  // middle of the exposure.
  MovingSensor c({0, 0, 0});
  c.m.modulation.taps = models::TofTaps::single;
  c.b.wall(3);
  c.b.engine->add(Sphere{.centre = {0, 0, 2}, .radius_m = 0.06},
                  {.node = c.kBall, .velocity_m_per_s = {20, 0, 0}, .t_ref = c.b.t});
  const TofPicture full = c.in_full();
  c.b.world.moving_nodes = {c.kBall};
  c.b.world.moves = true;
  const TofPicture p = c.b.shoot(c.m);
  for (std::size_t i = 0; i < p.range_m.size(); ++i) ASSERT_NEAR(p.range_m[i], full.range_m[i], 0.002) << i;
}

TEST(PlainPixels, AreCastOnceAndHaveTheRangeOfTheirMiddle) {
  TofBench b;
  const Eigen::Vector3d n = Eigen::Vector3d(0.8, 0.1, -0.6).normalized();
  b.engine->add(Plane{.point = {0, 0, 2}, .normal = n}, {.reflectance = grey(0.8F)});
  TofModel m = perfect(40, 30, 100);
  for (const int samples : {4, 16}) {
    m.sampling.samples = samples;
    b.engine->rays_cast = 0;
    const TofPicture p = b.shoot(m);
    EXPECT_EQ(b.engine->rays_cast, 1200u + static_cast<unsigned>(samples - 1) * 136u);  // the border in full
    for (int v = 1; v < 29; ++v)
      for (int u = 1; u < 39; ++u) {
        const Eigen::Vector3d d = Eigen::Vector3d((u - m.cx_px) / 100, (v - m.cy_px) / 100, 1).normalized();
        ASSERT_NEAR(p.range_m[size_t(v * 40 + u)], n.dot(Eigen::Vector3d(0, 0, 2)) / n.dot(d), 2e-5);
      }
  }
}

TEST(PlainPixels, AThinThingIsFollowedAlongItsWay) {
  // A pole of a third of a pixel, upright as the columns are: of 60 rows each first sample finds it one time
  // in three.
  TofModel m = perfect(15, 60, 500);
  m.sampling.samples = 16;
  TofBench b;
  b.wall(kFar_m, 0.8F);
  const double width = kNear_m / m.fx_px / 3;
  b.engine->add(
      Rectangle{
          .centre = {0.2 * kNear_m / m.fx_px, 0, kNear_m}, .half_u = {width / 2, 0, 0}, .half_v = {0, 5, 0}},
      {.reflectance = grey(0.4F)});
  const TofPicture p = b.shoot(m, 0, true);
  const double e_near = m.active_electrons(kNear_m, 0.4), e_far = m.active_electrons(kFar_m, 0.8);
  double covered = 0;
  for (int v = 0; v < 60; ++v) {
    const std::size_t i = 4 * size_t(v * 15 + 7);
    const double e =
        (double(p.taps[i]) + double(p.taps[i + 1]) + double(p.taps[i + 2]) + double(p.taps[i + 3])) / 2;
    covered += (e - e_far) / (e_near - e_far) / 60;
  }
  EXPECT_NEAR(covered, 1.0 / 3, 0.02);
}

TEST(PlainPixels, AreNotWhereReflectancesDiffer) {
  // A wall whose right half is dark, seen straight on: the pixel of the boundary has the mean of both.
  TofBench b;
  b.engine->add(Plane{.point = {0, 0, 2}, .normal = {0, 0, -1}},
                {.reflectance = grey(0.8F), .map = [](render::Hit& hit, const Eigen::Vector3d& p, int) {
                   if (p.x() > 0) hit.reflectance = 0.2F;
                 }});
  TofModel m = perfect(11, 40, 1000);
  m.sampling.samples = 16;
  const TofPicture p = b.shoot(m);
  double mean = 0;
  for (int v = 0; v < 40; ++v) mean += double(p.amplitude[size_t(v * 11 + 5)]) / 40;
  EXPECT_NEAR(mean / (m.active_electrons(2, 0.5) / 4), 1, 0.02);
}

TEST(PlainPixels, AreNotWhereGlossDiffers) {
  // Of the same reflectance, half of it a metal: the boundary pixel has half of the light of either.
  TofBench b;
  b.engine->add(Plane{.point = {0, 0, 2}, .normal = {0, 0, -1}},
                {.reflectance = grey(0.5F), .map = [](render::Hit& hit, const Eigen::Vector3d& p, int) {
                   if (p.x() > 0) hit.metallic = 1, hit.roughness = 0.9F;
                 }});
  TofModel m = perfect(11, 40, 1000);
  m.sampling.samples = 16;
  const TofPicture p = b.shoot(m);
  double mean = 0, left = 0, right = 0;
  for (int v = 1; v < 39; ++v) {
    mean += double(p.amplitude[size_t(v * 11 + 5)]);
    left += double(p.amplitude[size_t(v * 11 + 3)]), right += double(p.amplitude[size_t(v * 11 + 7)]);
  }
  EXPECT_GT(left, 2 * right);
  EXPECT_NEAR(mean / ((left + right) / 2), 1, 0.05);
}

TEST(PlainPixels, AreNotWhereNormalsDiffer) {
  // A fold in the shading of a flat wall, as normal maps make it: one half is turned to the sun, the other
  // away.
  TofBench b;
  b.engine->add(Plane{.point = {0, 0, 2}, .normal = {0, 0, -1}},
                {.reflectance = grey(0.5F), .map = [](render::Hit& hit, const Eigen::Vector3d& p, int) {
                   hit.normal[0] = p.x() > 0 ? 0.5F : -0.5F, hit.normal[2] = -0.866F;
                 }});
  auto& light = b.world.still.frame.light;
  light.direction_to_sun = {1, 0, 0.01};
  light.sun_irradiance = grey(40);
  TofModel m = perfect(11, 40, 1000);
  m.illumination.radiant_intensity_w_per_sr = 1e-6;
  m.optics.filter_width_m = 50e-9;
  m.sampling.samples = 16;
  m.sampling.sun_shadows = false;
  const TofPicture p = b.shoot(m, 0, true);
  for (int v = 1; v < 39; ++v) {
    const auto tap = [&](int u) { return double(p.taps[4 * size_t(v * 11 + u)]); };
    EXPECT_NEAR(tap(5) / (tap(3) + tap(7)), 0.5, 0.2) << v;
  }
}

TEST(PlainPixels, AreThoseThatHaveTooLittleLightToBeMeasured) {
  // A heap of balls: in the light all samples are cast, beyond what can be measured one.
  TofModel m = perfect(30, 30, 60);
  m.sampling.samples = 16;
  const auto rays = [&](double range_m) {
    TofBench b;
    for (int i = -12; i <= 12; ++i)
      for (int j = -12; j <= 12; ++j)
        b.engine->add(
            Sphere{.centre = {i * 0.05 * range_m, j * 0.05 * range_m, range_m}, .radius_m = 0.02 * range_m});
    m.limits.min_amplitude_e = m.active_electrons(3, 1.0) * m.modulation.contrast / 2;
    b.engine->rays_cast = 0;
    (void)b.shoot(m);
    return b.engine->rays_cast;
  };
  EXPECT_GT(rays(1.5), 12u * 900u);
  EXPECT_LT(rays(9), 900u + 15u * 120u);
}

}  // namespace
}  // namespace rigor::test
