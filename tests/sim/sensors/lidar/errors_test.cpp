// Errors of range and remission, crosstalk, sun, and the air. Statistics have fixed seeds and limits of four
// standard deviations of the estimator.
#include <algorithm>
#include <map>

#include "sensor-hal/models/air/air_math.h"
#include "sensor-hal/models/lidar/lidar_math.h"
#include "tests/sim/sensors/lidar/lidar_test_support.h"

namespace rigor {
namespace {

using namespace test;
using models::LidarModel;
using Math = models::LidarMath<double>;
using Air = models::AirMath<double>;
constexpr std::uint32_t kShots = 20000;

TEST(LidarNoise, HasTheSigmaOfItsFormulaAtEveryRemission) {
  AnalyticWorld world;
  LidarModel m = staring(kShots);
  m.noise = {.floor_m = 0.002, .scale_m = 0.00633, .offset = 0.172, .exponent = 1};
  for (const float rho : {0.02F, 0.1F, 0.3F, 0.9F}) {
    const auto s = scan(m, wall(20, {.reflectance = grey(rho)}), world);
    ASSERT_EQ(s.points.size(), kShots);
    const PointMoments got = moments(s.points, range_of);
    const double sigma = Math::lidar_range_sigma_m(static_cast<double>(rho), 0.002, 0.00633, 0.172, 1);
    // Sigma of a sigma: 1/sqrt(2 (n − 1)).
    EXPECT_NEAR(got.sigma, sigma, 4 * sigma / std::sqrt(2.0 * kShots)) << rho;
    EXPECT_NEAR(got.mean, 20, 4 * sigma / std::sqrt(1.0 * kShots)) << rho;
  }
}

TEST(LidarNoise, GrowsAsPowerFallsWithRangeWhereAReferenceSaysSo) {
  AnalyticWorld world;
  LidarModel m = staring(kShots);
  m.noise = {.scale_m = 0.01, .exponent = 0.5, .reference_range_m = 10};
  for (const double range : {10.0, 40.0}) {
    const auto s = scan(m, wall(range, {.reflectance = grey(0.25F)}), world);
    const double sigma = 0.01 / std::sqrt(0.25 * 100 / (range * range));
    EXPECT_NEAR(moments(s.points, range_of).sigma, sigma, 4 * sigma / std::sqrt(2.0 * kShots)) << range;
  }
}

TEST(LidarNoise, OfRetroReflectorsIsItsOwn) {
  AnalyticWorld world;
  LidarModel m = staring(kShots);
  m.noise = {.scale_m = 0.006, .offset = 0.17, .retro_sigma_m = 0.03};
  m.retro.gain = 100;
  const auto s = scan(m, wall(20, {.retro_reflection = 0.5F}), world);
  EXPECT_NEAR(moments(s.points, range_of).sigma, 0.03, 4 * 0.03 / std::sqrt(2.0 * kShots));
}

TEST(LidarNoise, OfRemissionIsRelative) {
  AnalyticWorld world;
  LidarModel m = staring(kShots);
  m.remission = {.scale = 100, .noise = 0.05};
  const auto s = scan(m, wall(20), world);
  const PointMoments got =
      moments(s.points, [](const LidarPoint& p) { return static_cast<double>(p.remission); });
  EXPECT_NEAR(got.mean, 50, 4 * 2.5 / std::sqrt(1.0 * kShots));
  EXPECT_NEAR(got.sigma, 2.5, 4 * 2.5 / std::sqrt(2.0 * kShots));
  EXPECT_NEAR(moments(s.points, range_of).sigma, 0, 1e-9);
}

TEST(LidarNoise, IsItsChannelsSeedsAndCapturesAlone) {
  AnalyticWorld world;
  LidarModel m = staring(100);
  m.noise.floor_m = 0.01;
  const auto ranges = [&](const ScanOptions& o) {
    std::vector<double> r;
    for (const LidarPoint& p : scan(m, wall(20), world, o).points) r.push_back(range_of(p));
    return r;
  };
  const auto reference = ranges({});
  EXPECT_EQ(ranges({}), reference);  // another engine, another simulator
  EXPECT_NE(ranges({.seed = 2}), reference);
  EXPECT_NE(ranges({.index = 1}), reference);
  EXPECT_NE(ranges({.name = "other"}), reference);
  // A firing's draw does not depend on what the others met.
  const auto farther = [&] {
    LidarModel n = m;
    n.scan.columns = 50;
    std::vector<double> r;
    for (const LidarPoint& p : scan(n, wall(20), world).points) r.push_back(range_of(p));
    return r;
  }();
  EXPECT_TRUE(std::equal(farther.begin(), farther.end(), reference.begin()));
}

TEST(LidarBias, IsTheBeamsAndTheDevices) {
  LidarModel m = staring();
  m.scan.beams.assign(3, models::LidarBeam{});
  m.scan.beams[0].range_bias_m = -0.026;
  m.scan.beams[2].range_bias_m = 0.046;
  m.range.bias_m = 0.1;
  AnalyticWorld world;
  const auto s = scan(m, wall(10), world);
  ASSERT_EQ(s.points.size(), 3U);
  EXPECT_NEAR(range_of(s.points[0]), 10.074, 1e-5);
  EXPECT_NEAR(range_of(s.points[1]), 10.1, 1e-5);
  EXPECT_NEAR(range_of(s.points[2]), 10.146, 1e-5);
  EXPECT_NEAR(range_of(scan(m, wall(10), world, {.ideal = true}).points.at(2)), 10, 1e-5);
}

TEST(LidarBias, GrowsWithRangeDarknessAndIncidence) {
  LidarModel m = staring();
  m.range.scale = 1.004;
  m.range.remission_bias_m = 0.03;
  m.range.incidence_bias_m = 0.05;
  AnalyticWorld world;
  for (const double deg : {0.0, 60.0}) {
    const double c = std::cos(deg * kDegree);
    for (const float rho : {0.2F, 0.8F}) {
      auto engine = std::make_shared<AnalyticEngine>();
      engine->add(Plane{.point = {10, 0, 0}, .normal = {-c, std::sin(deg * kDegree), 0}},
                  {.reflectance = grey(rho)});
      const auto s = scan(m, std::move(engine), world);
      ASSERT_EQ(s.points.size(), 1U);
      EXPECT_NEAR(range_of(s.points[0]), 10.04 + 0.03 * (1 - static_cast<double>(rho) * c) + 0.05 * (1 - c),
                  1e-5);
    }
  }
  // A footprint's returns are one echo at the mean of their incidence.
  m.footprint = {.horizontal_divergence_rad = 0.001, .vertical_divergence_rad = 0.001, .sub_rays = 7};
  m.echoes.separation_m = 1;
  auto engine = std::make_shared<AnalyticEngine>();
  engine->add(Plane{.point = {10, 0, 0}, .normal = {-0.5, std::sqrt(0.75), 0}}, {.reflectance = grey(0.2F)});
  EXPECT_NEAR(range_of(scan(m, std::move(engine), world).points.at(0)), 10.04 + 0.03 * 0.9 + 0.05 * 0.5,
              1e-4);
}

TEST(LidarQuantisation, RangesAreWholeSteps) {
  AnalyticWorld world;
  LidarModel m = staring(2000);
  m.range.step_m = 0.002;
  m.noise.floor_m = 0.01;
  const auto s = scan(m, wall(10.0007), world);
  std::map<long, int> steps;
  for (const LidarPoint& p : s.points) {
    const double step = range_of(p) / 0.002;
    EXPECT_NEAR(step, std::round(step), 1e-3);
    ++steps[std::lround(step)];
  }
  EXPECT_GT(steps.size(), 20U);
  m.noise.floor_m = 0;
  EXPECT_NEAR(range_of(scan(m, wall(10.0007), world).points.at(0)), 10.0, 1e-6);
}

// --- Air
// ---------------------------------------------------------------------------------------------------------

TEST(LidarFog, TakesRemissionByKimFrom50MetresTo50Kilometres) {
  LidarModel m = staring();
  for (const double visibility : {50.0, 200.0, 800.0, 3000.0, 20000.0, 50000.0}) {
    AnalyticWorld world;
    const double alpha = Air::air_fog_extinction_per_m(visibility, 905);
    world.frame.hazes.push_back({.extinction_per_m = grey(static_cast<float>(alpha))});
    for (const double range : {5.0, 50.0}) {
      const auto s = scan(m, wall(range), world);
      ASSERT_EQ(s.points.size(), 1U);
      const double expected = 0.5 * std::exp(-2 * alpha * range);
      EXPECT_NEAR(s.points[0].remission, expected, 2e-5 * expected + 1e-9) << visibility << " " << range;
      EXPECT_NEAR(scan(m, wall(range), world, {.ideal = true}).points.at(0).remission, 0.5, 1e-6);
    }
  }
}

TEST(LidarFog, ReachesUpToItsTop) {
  LidarModel m = staring();
  m.scan.beams[0].elevation_rad = std::asin(0.5);
  AnalyticWorld world;
  world.frame.hazes.push_back({.extinction_per_m = grey(0.01F), .top_m = 4});
  auto engine = std::make_shared<AnalyticEngine>();
  engine->add(Plane{.point = {0, 0, 11}, .normal = {0, 0, -1}});
  // From 1 m up at 30 degrees: 6 m of way below the top, 20 m to the ceiling, which is met at 60 degrees.
  const auto s = scan(m, engine, world, {.pose = still({0, 0, 1})});
  ASSERT_EQ(s.points.size(), 1U);
  EXPECT_NEAR(s.points[0].remission, 0.5 * 0.5 * std::exp(-2 * 0.01 * 6), 1e-6);
}

TEST(LidarFog, MakesNoiseGrowAndTargetsVanish) {
  LidarModel m = staring(kShots);
  m.noise = {.scale_m = 0.00633, .offset = 0.172, .exponent = 1};
  m.detection = {.limit_remission = 0.1, .limit_range_m = 50};
  AnalyticWorld world;
  world.frame.hazes.push_back({.extinction_per_m = grey(0.02F)});
  const double sigma = Math::lidar_range_sigma_m(0.5 * std::exp(-0.8), 0, 0.00633, 0.172, 1);
  EXPECT_NEAR(moments(scan(m, wall(20), world).points, range_of).sigma, sigma,
              4 * sigma / std::sqrt(2.0 * kShots));
  // At 60 m: 0.5 e^(−2.4) = 0.045 of the 0.144 that it takes.
  EXPECT_EQ(scan(m, wall(60), world).points.size(), 0U);
  world.frame.hazes.clear();
  EXPECT_EQ(scan(m, wall(60), world).points.size(), kShots);
}

TEST(LidarFog, DenseFogAnswersItself) {
  LidarModel m = staring();
  m.detection = {.minimum_remission = 0.005, .overlap_m = 2};
  m.air = {.lidar_ratio_sr = 18, .pulse_length_m = 0.9};
  AnalyticWorld world;
  const double alpha = Air::air_fog_extinction_per_m(50, 905);
  world.frame.hazes.push_back({.extinction_per_m = grey(static_cast<float>(alpha))});
  const auto s = scan(m, std::make_shared<AnalyticEngine>(), world);
  ASSERT_EQ(s.points.size(), 1U);
  EXPECT_NEAR(range_of(s.points[0]), 2, 1e-6);
  EXPECT_NEAR(s.points[0].remission, std::numbers::pi * alpha / 18 * 0.9 * std::exp(-4 * alpha), 1e-6);
  EXPECT_EQ(s.truth.class_names.at(s.truth.class_index[0]), "precipitation");
  // Haze of 5 km is too thin for that.
  world.frame.hazes = {
      {.extinction_per_m = grey(static_cast<float>(Air::air_fog_extinction_per_m(5000, 905)))}};
  EXPECT_EQ(scan(m, std::make_shared<AnalyticEngine>(), world).points.size(), 0U);
}

LidarModel in_rain(AnalyticWorld& world, std::uint32_t shots, double rain_mmph) {
  LidarModel m = staring(shots);
  m.footprint = {
      .horizontal_divergence_rad = 0.003, .vertical_divergence_rad = 0.003, .start_diameter_m = 0.01};
  m.range = {.min_m = 0.5, .max_m = 100};
  m.detection = {.limit_remission = 0.1, .limit_range_m = 50};
  m.air.drop_reflectance = 0.35;
  const double alpha = Air::air_rain_extinction_per_m(rain_mmph), d = Air::air_rain_diameter_m(rain_mmph);
  world.frame.precipitation = {.kind = render::Precipitation::Kind::rain,
                               .drops_per_m3 = static_cast<float>(Air::air_drops_per_m3(alpha, d)),
                               .diameter_m = static_cast<float>(d),
                               .extinction_per_m = grey(static_cast<float>(alpha))};
  return m;
}

TEST(LidarRain, SingleDropsReturnAsOftenAsPoissonSays) {
  for (const double rain : {1.0, 10.0, 40.0}) {
    AnalyticWorld world;
    const LidarModel m = in_rain(world, kShots, rain);
    const auto s = scan(m, std::make_shared<AnalyticEngine>(), world);
    const double d = Air::air_rain_diameter_m(rain), alpha = Air::air_rain_extinction_per_m(rain);
    // The farthest drop that is seen, by stepping instead of solving.
    double reach = 0.5;
    while (0.35 * std::pow(d / (0.01 + 0.003 * reach), 2) * std::exp(-2 * alpha * reach) >=
           0.1 * reach * reach / 2500)
      reach += 1e-4;
    // Expected number, by summing slices of the beam.
    double expected = 0;
    for (double r = 0.5; r < reach; r += 1e-3)
      expected += world.frame.precipitation.drops_per_m3 * M_PI / 4 * std::pow(0.01 + 0.003 * (r + 5e-4), 2) *
                  std::min(1e-3, reach - r);
    const double p = 1 - std::exp(-expected);
    EXPECT_NEAR(static_cast<double>(s.points.size()), p * kShots, 4 * std::sqrt(p * (1 - p) * kShots))
        << rain;
    ASSERT_FALSE(s.points.empty());
    for (const LidarPoint& point : s.points) {
      EXPECT_GE(range_of(point), 0.5 - 1e-6);
      EXPECT_LE(range_of(point), reach + 1e-3);
    }
    // Half of them by the range at which half of the probability is used up.
    double sum = 0, median = 0.5;
    for (; 1 - std::exp(-sum) < p / 2; median += 1e-4)
      sum += world.frame.precipitation.drops_per_m3 * M_PI / 4 * std::pow(0.01 + 0.003 * median, 2) * 1e-4;
    const auto nearer = std::count_if(s.points.begin(), s.points.end(),
                                      [&](const LidarPoint& q) { return range_of(q) < median; });
    const auto n = static_cast<double>(s.points.size());
    EXPECT_NEAR(static_cast<double>(nearer), n / 2, 4 * std::sqrt(n) / 2 + 0.001 * n) << rain;
    EXPECT_EQ(s.truth.class_names.at(s.truth.class_index[0]), "precipitation");
    EXPECT_EQ(s.truth.node[0], 0U);
  }
}

TEST(LidarRain, StrongTargetsPrevailOverDropsUnlessTheFirstIsAskedFor) {
  AnalyticWorld world;
  LidarModel m = in_rain(world, 5000, 10);
  m.echoes.separation_m = 0.3;
  const auto near_returns = [&](models::LidarReturns returns) {
    m.echoes.returns = returns;
    const auto s = scan(m, wall(20, {.reflectance = grey(0.8F)}), world);
    EXPECT_EQ(s.points.size(), 5000U);
    return std::count_if(s.points.begin(), s.points.end(),
                         [](const LidarPoint& p) { return range_of(p) < 19; });
  };
  const auto strongest = near_returns(models::LidarReturns::strongest);
  EXPECT_GT(near_returns(models::LidarReturns::first), 3 * strongest);
  EXPECT_EQ(near_returns(models::LidarReturns::last), 0);
}

TEST(LidarRain, NoDropIsSeenBehindATarget) {
  AnalyticWorld world;
  LidarModel m = in_rain(world, 2000, 10);
  m.echoes.returns = models::LidarReturns::last;
  const auto s = scan(m, wall(1), world);
  EXPECT_EQ(s.points.size(), 2000U);
  for (const LidarPoint& p : s.points) EXPECT_LE(range_of(p), 1 + 1e-6);
}

TEST(LidarRain, WithoutItsParameterOrRainThereIsNone) {
  AnalyticWorld world;
  LidarModel m = in_rain(world, 2000, 10);
  m.air.drop_reflectance = 0;
  EXPECT_EQ(scan(m, std::make_shared<AnalyticEngine>(), world).points.size(), 0U);
  m.air.drop_reflectance = 0.35;
  EXPECT_EQ(scan(m, std::make_shared<AnalyticEngine>(), world, {.ideal = true}).points.size(), 0U);
  world.frame.precipitation = {};
  EXPECT_EQ(scan(m, std::make_shared<AnalyticEngine>(), world).points.size(), 0U);
}

// --- Retro-reflectors and the sun
// ----------------------------------------------------------------------------------

TEST(LidarCrosstalk, GhostsStandBesideARetroReflectorAndNowhereElse) {
  // 9 beams two degrees apart, columns of one degree, nothing but a small reflector on the axis.
  LidarModel m = sweep(10, 1);
  m.scan.beams.assign(9, models::LidarBeam{});
  // Not in the order of elevation: neighbours are those in space.
  const int order[] = {4, 0, 8, 2, 6, 1, 5, 3, 7};
  for (std::size_t i = 0; i < 9; ++i) m.scan.beams[i].elevation_rad = (order[i] - 4) * 2 * kDegree;
  m.retro = {.gain = 100, .crosstalk = 0.01, .crosstalk_beams = 1, .crosstalk_columns = 2};
  m.detection.minimum_remission = 1e-3;
  auto engine = std::make_shared<AnalyticEngine>();
  engine->add(Sphere{.centre = {20, 0, 0}, .radius_m = 0.05},
              {.reflectance = grey(0), .retro_reflection = 0.5F});
  AnalyticWorld world;
  const auto s = scan(m, engine, world);
  std::map<std::pair<int, int>, float> seen;  // column, elevation step
  for (const LidarPoint& p : s.points) {
    EXPECT_NEAR(range_of(p), 19.95, 1e-4);
    seen[{static_cast<int>(std::lround(std::atan2(p.y_m, p.x_m) / kDegree)), order[p.ring] - 4}] =
        p.remission;
  }
  // E = 50; a share of 0.01 for each step: 0.5 at one, 0.005 at two, 5e-5 (not seen) at three.
  ASSERT_TRUE(seen.count({0, 0}));
  for (const auto& [where, remission] : seen) {
    const int steps = std::abs(where.first) + std::abs(where.second);
    if (steps == 0) continue;
    EXPECT_LE(steps, 2);
    EXPECT_LE(std::abs(where.second), 1);
    EXPECT_NEAR(remission, 50 * std::pow(0.01, steps), 1e-5);
  }
  EXPECT_EQ(seen.size(), 1U + 4 + 4 + 2);  // itself; four beside; four across the corner; two columns away
  m.retro.crosstalk = 0;
  EXPECT_EQ(scan(m, engine, world).points.size(), 1U);
}

TEST(LidarCrosstalk, AGhostMergesWithWhatIsNearIt) {
  LidarModel m = sweep(2, 1);
  m.retro = {.gain = 100, .crosstalk = 0.01};
  m.echoes.separation_m = 1;
  auto engine = std::make_shared<AnalyticEngine>();
  engine->add(Sphere{.centre = {20, 0, 0}, .radius_m = 0.05},
              {.reflectance = grey(0), .retro_reflection = 0.5F});
  engine->add(Plane{.point = {20.45, 0, 0}, .normal = {-1, 0, 0}});
  AnalyticWorld world;
  const auto s = scan(m, engine, world);
  ASSERT_EQ(s.points.size(), 5U);
  // Beside it the ghost of 0.5 at 19.95 and the wall's 0.5 at 20.453: half-way, and twice as bright.
  const double pg = 0.5 / (19.95 * 19.95), wall_m = 20.45 / std::cos(kDegree),
               pw = 0.5 * std::cos(kDegree) / (wall_m * wall_m);
  EXPECT_NEAR(range_of(s.points[1]), (pg * 19.95 + pw * wall_m) / (pg + pw), 1e-4);
  EXPECT_NEAR(s.points[1].remission, 1.0, 0.01);
  EXPECT_NEAR(range_of(s.points[0]), 20.45 / std::cos(2 * kDegree), 1e-4);
}

TEST(LidarSun, BlindsWithinItsConeWhereItIsUpAndInSight) {
  LidarModel m = sweep(30, 0.5);
  m.detection.minimum_remission = 0.1;
  m.sun = {.half_angle_rad = 3 * kDegree, .gain_m2_per_w = 1};
  // A fence of thin bars lets the sun be seen past what the beams meet.
  AnalyticWorld world;
  world.frame.light.direction_to_sun = Eigen::Vector3d(1, 0, 0.02).normalized();
  world.frame.light.sun_irradiance = grey(30);
  auto engine = std::make_shared<AnalyticEngine>();
  // Beams meet a low wall; the sun's centre stands just above its edge.
  engine->add(Rectangle{.centre = {10, 0, -5 + 0.1}, .half_u = {0, 50, 0}, .half_v = {0, 0, 5}});
  const auto blind = scan(m, engine, world);
  std::size_t missing = 0;
  for (int i = 0; i <= 120; ++i) {
    const double a = (-30 + 0.5 * i) * kDegree;
    const bool in_cone = std::cos(a) * world.frame.light.direction_to_sun.x() > std::cos(3 * kDegree);
    missing += in_cone;
    const bool there = std::any_of(blind.points.begin(), blind.points.end(), [&](const LidarPoint& p) {
      return std::abs(std::atan2(p.y_m, p.x_m) - a) < 1e-4;
    });
    EXPECT_EQ(there, !in_cone) << a / kDegree;
  }
  EXPECT_GE(missing, 10U);
  // Hidden behind a higher wall, below the horizon, or without strength: none is missing.
  auto high = std::make_shared<AnalyticEngine>();
  high->add(Rectangle{.centre = {10, 0, 0}, .half_u = {0, 50, 0}, .half_v = {0, 0, 5}});
  EXPECT_EQ(scan(m, high, world).points.size(), 121U);
  world.frame.light.direction_to_sun = Eigen::Vector3d(1, 0, -0.001).normalized();
  EXPECT_EQ(scan(m, engine, world).points.size(), 121U);
  world.frame.light.direction_to_sun = Eigen::Vector3d(1, 0, 0.02).normalized();
  world.frame.light.sun_irradiance = grey(0);
  EXPECT_EQ(scan(m, engine, world).points.size(), 121U);
  world.frame.light.sun_irradiance = grey(30);
  EXPECT_EQ(scan(m, engine, world, {.ideal = true}).points.size(), 121U);
}

TEST(LidarSun, MakesNoiseOfWhatItDoesNotHide) {
  LidarModel m = staring(kShots);
  m.noise.floor_m = 0.01;
  m.sun = {.half_angle_rad = 3 * kDegree, .gain_m2_per_w = 0.1};
  AnalyticWorld world;
  world.frame.light.direction_to_sun = Eigen::Vector3d(1, 0, 0.02).normalized();
  world.frame.light.sun_irradiance = grey(30);
  auto engine = std::make_shared<AnalyticEngine>();
  engine->add(Rectangle{.centre = {10, 0, -5 + 0.1}, .half_u = {0, 50, 0}, .half_v = {0, 0, 5}});
  const auto s = scan(m, engine, world);
  ASSERT_EQ(s.points.size(), kShots);
  EXPECT_NEAR(moments(s.points, range_of).sigma, 0.02, 4 * 0.02 / std::sqrt(2.0 * kShots));  // sqrt(1 + 3)
}

// --- What an effect costs
// -------------------------------------------------------------------------------------------

TEST(LidarCost, EffectsThatAreOffCastNoRay) {
  AnalyticWorld world;
  auto engine = wall(10);
  LidarModel m = sweep(30, 1);
  (void)scan(m, engine, world);
  EXPECT_EQ(engine->rays_cast, 61U);
  m.footprint.sub_rays = 5;
  engine->rays_cast = 0;
  (void)scan(m, engine, world);
  EXPECT_EQ(engine->rays_cast, 61U * 5);
  engine->rays_cast = 0;
  (void)scan(m, engine, world, {.ideal = true});
  EXPECT_EQ(engine->rays_cast, 61U);
  // The sun's rays only for the beams that look at it.
  m.footprint.sub_rays = 1;
  m.sun = {.half_angle_rad = 2.5 * kDegree, .gain_m2_per_w = 1};
  world.frame.light.direction_to_sun = Eigen::Vector3d(1, 0, 1e-6).normalized();
  world.frame.light.sun_irradiance = grey(30);
  engine->rays_cast = 0;
  (void)scan(m, engine, world);
  EXPECT_EQ(engine->rays_cast, 61U + 5);
}

}  // namespace
}  // namespace rigor
