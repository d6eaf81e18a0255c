// What a footprint with width returns: mixed pixels, echoes, remission, detection.
#include <tbb/global_control.h>

#include <cstring>
#include <set>

#include "tests/sim/sensors/lidar/lidar_test_support.h"

namespace rigor {
namespace {

using namespace test;
using models::LidarModel;
using models::LidarProfile;
using models::LidarReturns;

TEST(LidarRemission, FollowsLambertTo89Point9Degrees) {
  for (const double deg : {0.0, 30.0, 60.0, 80.0, 89.0, 89.9}) {
    auto engine = std::make_shared<AnalyticEngine>();
    engine->add(Plane{.point = {10, 0, 0}, .normal = {-std::cos(deg * kDegree), std::sin(deg * kDegree), 0}},
                {.reflectance = grey(0.6F)});
    AnalyticWorld world;
    LidarModel m = staring();
    m.remission.scale = 100;
    const auto s = scan(m, engine, world);
    ASSERT_EQ(s.points.size(), 1U);
    EXPECT_NEAR(s.points[0].remission, 60 * std::cos(deg * kDegree), 2e-5) << deg;
  }
}

TEST(LidarRemission, ReadsTheBandOfItsWavelength) {
  render::Spectrum bands{0.1F, 0.2F, 0.3F, 0.4F, 0.5F, 0.6F};
  AnalyticWorld world;
  for (const auto& [nm, expected] :
       {std::pair{785.0, 0.4}, {850.0, 0.4}, {905.0, 0.5}, {1550.0, 0.6}, {550.0, 0.2}}) {
    LidarModel m = staring();
    m.wavelength_nm = nm;
    EXPECT_NEAR(scan(m, wall(10, {.reflectance = bands}), world).points.at(0).remission, expected, 1e-6)
        << nm;
  }
}

TEST(LidarRemission, ChangesWithGlossColourAndNormalMapsAsWorkedOutByHand) {
  AnalyticWorld world;
  const auto remission = [&](auto map) {
    return static_cast<double>(
        scan(staring(), wall(10, {.reflectance = grey(0.4F), .map = map}), world).points.at(0).remission);
  };
  EXPECT_NEAR(remission([](render::Hit& h, const Eigen::Vector3d&, int) { h.reflectance *= 0.25F; }), 0.1,
              1e-6);
  // Roughness 0.5 square to the beam: 0.04 / (4 · 0.5⁴) = 0.16 more.
  EXPECT_NEAR(remission([](render::Hit& h, const Eigen::Vector3d&, int) { h.roughness = 0.5F; }), 0.56, 1e-6);
  // A bump of 60 degrees halves it.
  EXPECT_NEAR(remission([](render::Hit& h, const Eigen::Vector3d&, int) {
                h.normal[0] = -0.5F;
                h.normal[1] = std::sqrt(0.75F);
              }),
              0.2, 1e-6);
}

TEST(LidarRemission, SaturatesIsRoundedAndFallsWithRangeWhereItIsRaw) {
  AnalyticWorld world;
  LidarModel m = staring();
  m.remission = {.scale = 300, .retro_scale = 300, .maximum = 254, .step = 1};
  EXPECT_EQ(scan(m, wall(10, {.reflectance = grey(0.9F)}), world).points.at(0).remission, 254);
  EXPECT_EQ(scan(m, wall(10, {.reflectance = grey(0.5011F)}), world).points.at(0).remission, 150);
  m.remission = {.scale = 100, .range_exponent = 2, .reference_range_m = 10};
  EXPECT_NEAR(scan(m, wall(20, {.reflectance = grey(0.8F)}), world).points.at(0).remission, 20, 1e-5);
  // A beam's own gain.
  m.remission = {.scale = 100};
  m.scan.beams[0].remission_gain = 0.5;
  EXPECT_NEAR(scan(m, wall(20, {.reflectance = grey(0.8F)}), world).points.at(0).remission, 40, 1e-5);
}

TEST(LidarRemission, RetroReflectorsRiseAboveWhiteByTheirOwnScale) {
  AnalyticWorld world;
  LidarModel m = staring();
  m.retro.gain = 100;
  m.remission = {.scale = 100, .retro_scale = 3, .maximum = 255};
  // E = 0.2 + 0.3 · 100 = 30.2: 100 + 29.2 · 3.
  EXPECT_NEAR(
      scan(m, wall(10, {.reflectance = grey(0.2F), .retro_reflection = 0.3F}), world).points.at(0).remission,
      187.6, 1e-3);
}

TEST(LidarDetection, DarkTargetsGiveNoReturn) {
  AnalyticWorld world;
  LidarModel m = staring();
  m.detection.minimum_remission = 0.1;
  EXPECT_EQ(scan(m, wall(10, {.reflectance = grey(0.101F)}), world).points.size(), 1U);
  EXPECT_EQ(scan(m, wall(10, {.reflectance = grey(0.099F)}), world).points.size(), 0U);
  // Incidence counts.
  auto slanted = std::make_shared<AnalyticEngine>();
  slanted->add(Plane{.point = {10, 0, 0}, .normal = {-0.5, std::sqrt(0.75), 0}},
               {.reflectance = grey(0.19F)});
  EXPECT_EQ(scan(m, slanted, world).points.size(), 0U);
  // A limit by power: 10 % at 26 m is 40 % at 52 m.
  m.detection = {.limit_remission = 0.1, .limit_range_m = 26};
  EXPECT_EQ(scan(m, wall(52, {.reflectance = grey(0.401F)}), world).points.size(), 1U);
  EXPECT_EQ(scan(m, wall(52, {.reflectance = grey(0.399F)}), world).points.size(), 0U);
  EXPECT_EQ(scan(m, wall(13, {.reflectance = grey(0.026F)}), world).points.size(), 1U);
  EXPECT_EQ(scan(m, wall(13, {.reflectance = grey(0.024F)}), world).points.size(), 0U);
  // A perfect sensor sees them all.
  EXPECT_EQ(scan(m, wall(52, {.reflectance = grey(0.01F)}), world, {.ideal = true}).points.size(), 1U);
}

/// A beam of 20 mrad along x; a screen at 10 m covers all of y > edge (in beam radii), a wall stands behind.
struct Edge {
  std::shared_ptr<AnalyticEngine> engine = std::make_shared<AnalyticEngine>();
  LidarModel m = staring();
  AnalyticWorld world;

  Edge(double edge, double gap_m, float near_reflectance = 0.5F, float far_reflectance = 0.5F) {
    const double radius = 10 * std::tan(0.01);
    engine->add(Rectangle{.centre = {10, edge * radius + 50, 0}, .half_u = {0, 50, 0}, .half_v = {0, 0, 50}},
                {.reflectance = grey(near_reflectance), .node = {1}});
    engine->add(Plane{.point = {10 + gap_m, 0, 0}, .normal = {-1, 0, 0}},
                {.reflectance = grey(far_reflectance), .node = {2}});
    m.footprint = {.horizontal_divergence_rad = 0.02,
                   .vertical_divergence_rad = 0.02,
                   .profile = LidarProfile::top_hat,
                   .sub_rays = 256};
    m.echoes = {.separation_m = 1, .returns = LidarReturns::dual};
  }
};

/// Share of a disc beyond a chord at `edge` radii from the centre.
double segment(double edge) {
  return (std::acos(edge) - edge * std::sqrt(1 - edge * edge)) / std::numbers::pi;
}

TEST(LidarFootprint, StraddlingAnEdgeReturnsTwoByTheirShares) {
  for (const double edge : {-0.6, 0.0, 0.35}) {
    Edge e(edge, 3);
    const auto s = scan(e.m, e.engine, e.world);
    ASSERT_EQ(s.points.size(), 2U) << edge;
    const double share = segment(edge);
    const LidarPoint &near = s.points[0].x_m < 11 ? s.points[0] : s.points[1],
                     &far = s.points[0].x_m < 11 ? s.points[1] : s.points[0];
    // 256 rays: each 0.4 % of the light, a chord of 16 rays' diameters.
    EXPECT_NEAR(near.remission, 0.5 * share, 0.5 * 0.015) << edge;
    EXPECT_NEAR(far.remission, 0.5 * (1 - share), 0.5 * 0.015) << edge;
    EXPECT_NEAR(range_of(near), 10, 1e-3);  // the cap's sagitta at 10 mrad: 0.5 mm
    EXPECT_NEAR(range_of(far), 13, 1e-3);
    EXPECT_EQ(s.points[0].return_index, 0);
    EXPECT_EQ(s.points[1].return_index, 1);
  }
}

/// A veil at 10 m that covers 0.3 of every ray, and what another engine has behind it.
class Veil final : public render::RayEngine {
 public:
  explicit Veil(std::shared_ptr<render::RayEngine> behind) : behind_(std::move(behind)) {}
  std::string_view name() const override { return "veil"; }
  Status prepare(std::shared_ptr<const render::ContentWindow> w) override {
    return behind_->prepare(std::move(w));
  }
  Status cast(const render::RayQuery& q, std::span<render::Hit> hits) override {
    return behind_->cast(q, hits);
  }
  Status cast_layers(const render::RayQuery& q, render::LayeredHits& hits) override {
    widths.insert(q.half_width_per_m);
    rays += hits.rays();
    std::vector<render::Hit> far(hits.rays());
    if (auto s = cast(q, far); !s) return s;
    for (std::size_t i = 0; i < far.size(); ++i) {
      render::Hit veil = far[i];
      veil.range_m = range_m;
      veil.node = world::NodeId{7};
      hits.clear(i);
      if (half && i % 2 == 1) continue;
      hits.add(i) = {veil, 0.3F};
      hits.add(i) = {far[i], 0.7F};
    }
    return {};
  }
  render::EngineStatistics statistics() const override { return behind_->statistics(); }
  std::set<float> widths;
  std::size_t rays = 0;
  float range_m = 10;
  bool half = false;  ///< every other ray meets nothing

 private:
  std::shared_ptr<render::RayEngine> behind_;
};

TEST(LidarFootprint, LayersOfWideRaysAreEchoesByTheirShares) {
  for (const int most : {0, 16}) {
    Edge e(2, 3);  // the wall alone
    e.m.footprint.sub_rays = 4;
    e.m.footprint.most_sub_rays = most;
    const auto veil = std::make_shared<Veil>(e.engine);
    const auto s = scan(e.m, veil, e.world);
    ASSERT_EQ(s.points.size(), 2U) << most;
    const std::size_t near = s.points[0].x_m < 11 ? 0 : 1, far = 1 - near;
    EXPECT_NEAR(s.points[near].remission, 0.5 * 0.3, 1e-3) << most;
    EXPECT_NEAR(s.points[far].remission, 0.5 * 0.7, 1e-3) << most;
    EXPECT_NEAR(range_of(s.points[near]), 10, 1e-3);
    EXPECT_NEAR(range_of(s.points[far]), 13, 1e-2);
    EXPECT_EQ(s.truth.node[near], 7U);
    EXPECT_EQ(s.truth.node[far], 2U);
    // Four squares as large as the footprint together; what is true is asked of its middle.
    const double half = std::sqrt(std::numbers::pi / 4) / 2 * std::tan(0.01);
    EXPECT_NEAR(*veil->widths.rbegin(), half, 1e-6);
  }
}

TEST(LidarAddedRays, AreCastWhereHalfOfTheRaysMeetNothingAndTheOthersTwoLayers) {
  Edge e(2, 3);
  e.m.footprint.sub_rays = 4;
  e.m.footprint.most_sub_rays = 16;
  e.m.echoes.returns = LidarReturns::first;
  for (const bool half : {false, true}) {
    const auto veil = std::make_shared<Veil>(e.engine);
    veil->range_m = 12.95F;  // within the separation of the wall: one echo
    veil->half = half;
    static_cast<void>(scan(e.m, veil, e.world));
    EXPECT_EQ(veil->rays, half ? 17U : 5U);  // one for the true range
  }
}

TEST(LidarFootprint, EchoesNearerThanTheSeparationAreOneBetweenThem) {
  Edge apart(0.35, 1.01), together(0.35, 0.99);
  EXPECT_EQ(scan(apart.m, apart.engine, apart.world).points.size(), 2U);
  const auto s = scan(together.m, together.engine, together.world);
  ASSERT_EQ(s.points.size(), 1U);
  const double f = segment(0.35), pn = f / 100, pf = (1 - f) / (10.99 * 10.99);
  EXPECT_NEAR(range_of(s.points[0]), (pn * 10 + pf * 10.99) / (pn + pf), 0.015);
  EXPECT_GT(range_of(s.points[0]), 10.3);
}

TEST(LidarFootprint, ABrighterPartDrawsTheMixedRange) {
  Edge dark(0, 0.9, 0.1F, 0.9F), bright(0, 0.9, 0.9F, 0.1F);
  EXPECT_NEAR(range_of(scan(dark.m, dark.engine, dark.world).points.at(0)), 10 + 0.9 * 0.886, 0.02);
  EXPECT_NEAR(range_of(scan(bright.m, bright.engine, bright.world).points.at(0)), 10 + 0.9 * 0.086, 0.02);
}

TEST(LidarFootprint, OneRayNeverMixes) {
  Edge e(0.35, 0.5);
  e.m.footprint.sub_rays = 1;
  EXPECT_NEAR(range_of(scan(e.m, e.engine, e.world).points.at(0)), 10.5, 1e-6);
}

TEST(LidarFootprint, GaussianBeamsWeighTheirMiddle) {
  // A black ball hides half the beam's radius: it takes the share (1 − e^(−2·¼))/(1 − e⁻²).
  AnalyticWorld world;
  LidarModel m = staring();
  m.footprint = {.horizontal_divergence_rad = 0.02, .vertical_divergence_rad = 0.02, .sub_rays = 256};
  m.echoes = {.separation_m = 0.5, .returns = LidarReturns::last};
  const double r = 0.5 * 10 * std::tan(0.01);
  auto disc = std::make_shared<AnalyticEngine>();
  disc->add(Sphere{.centre = {10, 0, 0}, .radius_m = r}, {.reflectance = grey(0.0F)});
  disc->add(Plane{.point = {40, 0, 0}, .normal = {-1, 0, 0}}, {.reflectance = grey(0.5F)});
  const double hidden = (1 - std::exp(-0.5)) / (1 - std::exp(-2.0));
  EXPECT_NEAR(scan(m, disc, world).points.at(0).remission, 0.5 * (1 - hidden), 0.5 * 0.02);
}

TEST(LidarFootprint, StartsWithItsDiameter) {
  // A parallel beam of 40 mm past an edge 10 mm to the left of its axis, at any range.
  LidarModel m = staring();
  m.footprint = {.start_diameter_m = 0.04, .profile = LidarProfile::top_hat, .sub_rays = 256};
  m.echoes.separation_m = 0.5;
  m.echoes.returns = LidarReturns::first;
  AnalyticWorld world;
  for (const double x : {1.0, 30.0}) {
    auto engine = std::make_shared<AnalyticEngine>();
    engine->add(Rectangle{.centre = {x, 50.01, 0}, .half_u = {0, 50, 0}, .half_v = {0, 0, 50}});
    const auto s = scan(m, engine, world);
    ASSERT_EQ(s.points.size(), 1U);
    EXPECT_NEAR(s.points[0].remission, 0.5 * segment(0.5), 0.5 * 0.015);
    EXPECT_NEAR(range_of(s.points[0]), x, 1e-5);
  }
}

/// 100 shots at a plate at 10 m, `share` of the beam on it, before a wall at 14 m.
struct AddedRays {
  std::shared_ptr<AnalyticEngine> engine = std::make_shared<AnalyticEngine>();
  AnalyticWorld world;
  LidarModel m = staring(100);
  explicit AddedRays(double edge_m) {
    engine->add(Rectangle{.centre = {10, 5 + edge_m, 0}, .half_u = {0, 5, 0}, .half_v = {0, 0, 5}},
                {.node = world::NodeId{3}});
    engine->add(Plane{.point = {14, 0, 0}, .normal = {-1, 0, 0}}, {.node = world::NodeId{4}});
    m.footprint = {.horizontal_divergence_rad = 0.02,
                   .vertical_divergence_rad = 0.02,
                   .profile = LidarProfile::top_hat,
                   .sub_rays = 4,
                   .most_sub_rays = 64};
    m.echoes.separation_m = 1;
  }
};

TEST(LidarAddedRays, AreNotCastWhereTheEchoIsClear) {
  AddedRays plain(-1);
  EXPECT_EQ(scan(plain.m, plain.engine, plain.world).points.size(), 100U);
  EXPECT_EQ(plain.engine->rays_cast, 500U);  // one more each for the truth of ranges
  // Nothing is clear as well.
  AddedRays nothing(-1);
  nothing.engine->clear();
  EXPECT_TRUE(scan(nothing.m, nothing.engine, nothing.world).points.empty());
  EXPECT_EQ(nothing.engine->rays_cast, 500U);
}

TEST(LidarAddedRays, TellWhichOfTwoEchoesIsTheStrongest) {
  // 0.55 of the beam's disc meets the wall, whose power is half that of the plate by its range: few of 100
  // shots may take the wall for the strongest. Four rays alone do so often.
  const double edge_m = 10 * std::tan(0.01) * 0.08;
  const auto at_the_wall = [](AddedRays& a) {
    int n = 0;
    for (const LidarPoint& p : scan(a.m, a.engine, a.world).points) n += range_of(p) > 12;
    return n;
  };
  AddedRays added(edge_m), few(edge_m);
  few.m.footprint.sub_rays = 3;
  few.m.footprint.most_sub_rays = 4;
  const int with = at_the_wall(added), without = at_the_wall(few);
  EXPECT_LE(with, 3);
  EXPECT_GT(without, with + 5);
  EXPECT_GT(added.engine->rays_cast, 800U);
  EXPECT_LT(added.engine->rays_cast, 6400U);
}

TEST(LidarAddedRays, GiveTheSameScanOnAnyNumberOfThreadsAndItsTruth) {
  AddedRays a(0);
  a.m.echoes.returns = LidarReturns::dual;
  Scanned one;
  for (const std::size_t threads : {1u, 4u}) {
    const tbb::global_control limit(tbb::global_control::max_allowed_parallelism, threads);
    Scanned s = scan(a.m, a.engine, a.world);
    ASSERT_GT(s.points.size(), 150U);
    for (std::size_t i = 0; i < s.points.size(); ++i)
      EXPECT_EQ(s.truth.node[i], range_of(s.points[i]) < 12 ? 3U : 4U) << i;
    if (threads == 1) {
      one = s;
      continue;
    }
    ASSERT_EQ(s.points.size(), one.points.size());
    EXPECT_EQ(std::memcmp(s.points.data(), one.points.data(), s.points.size() * sizeof(LidarPoint)), 0);
  }
}

TEST(LidarReturnModes, TellFirstLastStrongestAndDual) {
  // Three screens: a dark share in front, a bright one, a dark wall.
  auto engine = std::make_shared<AnalyticEngine>();
  const double radius = 10 * std::tan(0.01);
  engine->add(Rectangle{.centre = {10, 50 + 0.4 * radius, 0}, .half_u = {0, 50, 0}, .half_v = {0, 0, 50}},
              {.reflectance = grey(0.1F)});
  engine->add(Rectangle{.centre = {15, 50 - 0.4 * radius, 0}, .half_u = {0, 50, 0}, .half_v = {0, 0, 50}},
              {.reflectance = grey(0.9F)});
  engine->add(Plane{.point = {20, 0, 0}, .normal = {-1, 0, 0}}, {.reflectance = grey(0.1F)});
  AnalyticWorld world;
  LidarModel m = staring();
  m.footprint = {.horizontal_divergence_rad = 0.02, .vertical_divergence_rad = 0.02, .sub_rays = 61};
  m.echoes.separation_m = 1;
  const auto ranges = [&](LidarReturns returns) {
    m.echoes.returns = returns;
    std::vector<long> r;
    for (const LidarPoint& p : scan(m, engine, world).points) r.push_back(std::lround(range_of(p)));
    return r;
  };
  EXPECT_EQ(ranges(LidarReturns::first), (std::vector<long>{10}));
  EXPECT_EQ(ranges(LidarReturns::strongest), (std::vector<long>{15}));
  EXPECT_EQ(ranges(LidarReturns::last), (std::vector<long>{20}));
  EXPECT_EQ(ranges(LidarReturns::dual), (std::vector<long>{15, 20}));
  // What is not detected is not told.
  m.detection.minimum_remission = 0.08;
  EXPECT_EQ(ranges(LidarReturns::dual), (std::vector<long>{15}));
}

TEST(LidarReturnModes, DualTellsTheSecondStrongestWhereTheStrongestIsTheLast) {
  Edge e(0.35, 3, 0.2F, 0.9F);
  const auto s = scan(e.m, e.engine, e.world);
  ASSERT_EQ(s.points.size(), 2U);
  EXPECT_NEAR(range_of(s.points[0]), 13, 0.01);
  EXPECT_NEAR(range_of(s.points[1]), 10, 0.01);
  EXPECT_EQ(s.truth.node[0], 2U);
  EXPECT_EQ(s.truth.node[1], 1U);
}

TEST(LidarFootprint, ManyEchoesKeepTheFirstTheLastAndTheStrongest) {
  // 20 screens one behind the other, each reaching farther to the right: 20 stripes, more than are kept.
  auto engine = std::make_shared<AnalyticEngine>();
  for (int i = 0; i < 20; ++i) {
    const double x = 10.0 + 2 * i, edge = 0.02 * x * (0.9 - 0.09 * i);
    engine->add(Rectangle{.centre = {x, edge + 50, 0}, .half_u = {0, 50, 0}, .half_v = {0, 0, 50}},
                {.reflectance = grey(i == 11 ? 0.95F : 0.1F)});
  }
  AnalyticWorld world;
  LidarModel m = staring();
  m.footprint = {.horizontal_divergence_rad = 0.04,
                 .vertical_divergence_rad = 0.04,
                 .profile = LidarProfile::top_hat,
                 .sub_rays = 256};
  m.echoes.separation_m = 1;
  const auto range = [&](LidarReturns returns) {
    m.echoes.returns = returns;
    return std::lround(range_of(scan(m, engine, world).points.at(0)));
  };
  EXPECT_EQ(range(LidarReturns::first), 10);
  EXPECT_EQ(range(LidarReturns::strongest), 32);
  EXPECT_EQ(range(LidarReturns::last), 48);
}

}  // namespace
}  // namespace rigor
