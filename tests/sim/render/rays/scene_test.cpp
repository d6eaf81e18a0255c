// Changes, motion, levels of detail, threads, and content that is wrong.
#include <cstring>
#include <limits>
#include <set>

#include "sensor-hal/models/philox.h"
#include "tests/sim/render/rays/rays_fixture.h"
#include "tests/sim/render/view/synthetic_forest.h"

namespace rigor::test {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

std::vector<Ray> all_round(std::size_t n, const Vector3d& from) {
  std::vector<Ray> rays;
  for (std::uint32_t i = 0; i < n; ++i) {
    const auto w = models::philox({i, 1, 2, 3}, {5U, 7U});
    const double a = 6.283185307 * w[0] / 4294967296.0, z = 2.0 * w[1] / 4294967296.0 - 1;
    const double r = std::sqrt(1 - z * z);
    rays.push_back(ray_of(from, {r * std::cos(a), r * std::sin(a), z}));
  }
  return rays;
}
std::vector<std::shared_ptr<const Batch>> batches_of(const SyntheticForest& f) {
  auto all = f.trees;
  all.insert(all.begin(), f.ground);
  return all;
}
/// What a hit says, without its padding and addresses.
std::vector<float> numbers(const std::vector<Hit>& hits) {
  std::vector<float> v;
  for (const Hit& h : hits)
    v.insert(v.end(), {h.range_m, h.normal[0], h.normal[1], h.normal[2], h.cos_incidence, h.reflectance,
                       h.transmittance, h.roughness, h.uv[0], h.uv[1], static_cast<float>(h.node.value)});
  return v;
}
bool equal_bytes(const std::vector<float>& a, const std::vector<float>& b) {
  return a.size() == b.size() && std::memcmp(a.data(), b.data(), a.size() * sizeof(float)) == 0;
}

TEST_F(RaysTest, HitsAreTheSameOnAnyNumberOfThreads) {
  const SyntheticForest f = make_forest(120, 60, 12);
  const auto rays = all_round(5000, {0, 0, 2});
  std::vector<float> first;
  for (const int threads : {1, 2, 4}) {
    cache_ = *EmbreeCache::create();
    engine_ = make({.threads = threads});
    show(batches_of(f));
    const auto got = numbers(cast(rays));
    if (threads == 1) first = got;
    EXPECT_TRUE(equal_bytes(got, first)) << threads;
  }
}

TEST_F(RaysTest, AFelledTreeRebuildsNoMeshAndChangesWhatAFreshEngineSees) {
  const SyntheticForest f = make_forest(120, 60, 12);
  auto batches = batches_of(f);
  show(batches);
  EXPECT_EQ(engine_->statistics().rebuilt, 4U);
  EXPECT_EQ(engine_->statistics().instances, 121U);
  const auto rays = all_round(3000, {0, 0, 2});
  const auto before = numbers(cast(rays));
  show(batches);
  EXPECT_EQ(engine_->statistics().rebuilt, 0U);
  EXPECT_TRUE(equal_bytes(numbers(cast(rays)), before));

  auto fewer = std::make_shared<Batch>(*batches[3]);
  fewer->serial = next_serial();
  fewer->instances.pop_back();
  fewer->nodes.pop_back();
  const auto whole = batches[3];
  batches[3] = fewer;
  show(batches);
  EXPECT_EQ(engine_->statistics().rebuilt, 0U);
  EXPECT_EQ(engine_->statistics().instances, 120U);
  const auto felled = numbers(cast(rays));
  EXPECT_FALSE(equal_bytes(felled, before));
  auto fresh = make();
  ASSERT_TRUE(fresh->prepare(window_of(batches)));
  EXPECT_TRUE(equal_bytes(numbers(cast(*fresh, rays)), felled));
  // A batch that goes, and all back.
  batches.erase(batches.begin() + 3);
  show(batches);
  batches.insert(batches.begin() + 3, whole);
  show(batches);
  EXPECT_TRUE(equal_bytes(numbers(cast(rays)), before));
}

TEST_F(RaysTest, TheSameThingsInAnotherWindowAreTakenOverWithItsWeatherAndLevels) {
  auto s = surface_of(0.5F);
  s->porosity = 1;
  auto p = std::make_shared<Prototype>();
  p->levels = {{box_mesh({1, 1, 1}, s), 0}, {box_mesh({1, 1, 0.5F}, s), 0.5F}};
  const std::vector<std::shared_ptr<const Batch>> batches{batch_of(p, {at(0, 0, 0)}, 1)};
  show(batches);
  const auto placed = engine_->statistics();
  const float dry = shoot({0, 0, 5}, {0, 0, -1}).reflectance;
  const auto again = window_of(batches);
  show(again);
  EXPECT_EQ(engine_->window(), again.get());
  EXPECT_EQ(engine_->statistics().instances, placed.instances);
  EXPECT_EQ(engine_->statistics().triangles, placed.triangles);
  EXPECT_EQ(shoot({0, 0, 5}, {0, 0, -1}).range_m, 4);
  ContentFrame rain;
  rain.batches = batches;
  rain.surface.wetness = 1;
  show(window_of(std::vector<ContentFrame>{rain}));
  EXPECT_LT(shoot({0, 0, 5}, {0, 0, -1}).reflectance, 0.9F * dry);
  engine_->set_options({.allowed_error_rad = 0.2, .eye = {0, 0, 5}});
  show(window_of(batches));
  EXPECT_EQ(shoot({0, 0, 5}, {0, 0, -1}).range_m, 4.5F);
  EXPECT_EQ(shoot({0, 0, 5}, {0, 0, -1}).reflectance, dry);
}

TEST_F(RaysTest, ManySmallThingsAreMetAsEachOfThemAlone) {
  // More than a batch keeps in the scene itself, far from the world's origin and turned.
  auto p = prototype_of(box_mesh({0.1F, 0.2F, 0.3F}, surface_of(0.5F)));
  std::vector<Instance> many;
  for (int i = 0; i < 400; ++i) {
    Instance n = at(static_cast<float>(i % 20), static_cast<float>(i / 20), 0);
    turn(n, Eigen::Quaternionf(Eigen::AngleAxisf(0.1F * static_cast<float>(i), Vector3f::UnitZ())));
    many.push_back(n);
  }
  const Vector3d far(5000.25, -300.5, 20);
  auto b = batch_of(p, many, 0, far);
  for (std::uint64_t i = 0; i < 400; ++i) b->nodes.push_back(NodeId{i + 1});
  std::vector<std::shared_ptr<const Batch>> apart;
  for (std::size_t i = 0; i < 400; ++i) apart.push_back(batch_of(p, {many[i]}, i + 1, far));
  auto other = make();
  show({b});
  ASSERT_TRUE(other->prepare(window_of(apart)));
  const auto rays = all_round(4000, {9.5, 9.5, 0.1});
  const auto a = cast(rays, far), c = cast(*other, rays, far);
  std::size_t met = 0;
  for (std::size_t i = 0; i < rays.size(); ++i) {
    EXPECT_EQ(a[i].node.value, c[i].node.value);
    if (a[i].nothing()) continue;
    ++met;
    EXPECT_NEAR(a[i].range_m, c[i].range_m, 1e-5);
  }
  EXPECT_GT(met, 200U);
  std::vector<std::uint8_t> hidden(rays.size());
  ASSERT_TRUE(engine_->occluded({.origin = far, .rays = rays}, hidden));
  for (std::size_t i = 0; i < rays.size(); ++i) EXPECT_EQ(hidden[i] != 0, !a[i].nothing()) << i;
}

TEST_F(RaysTest, WhatMovesIsMetWhereItIsAtTheRaysInstant) {
  // Three instants: 0, 4 and 2 m to the east, 0, 2 and -1 m to the north; a still wall behind.
  auto p = prototype_of(box_mesh({0.5F, 0.5F, 0.5F}, surface_of(0.5F)));
  auto wall = one(box_mesh({50, 0.5F, 50}, surface_of(0.2F)), 9, {0, 10.5, 0});
  std::vector<ContentFrame> frames(3);
  const double x[3] = {0, 4, 2}, y[3] = {0, 2, -1};
  for (std::size_t k = 0; k < 3; ++k)
    frames[k].batches = {wall, batch_of(p, {at(0, 5.5F, 0)}, 3, {x[k], y[k], 0})};
  show(window_of(frames));
  const auto node = [&](double from, float time) { return shoot({from, 0, 0}, {0, 1, 0}, time).node.value; };
  struct Case {
    float time;
    double centre, north;
  };
  for (const auto& [time, centre, north] :
       {Case{0, 0, 0}, Case{0.25F, 2, 1}, Case{0.5F, 4, 2}, Case{0.75F, 3, 0.5}, Case{1, 2, -1}}) {
    EXPECT_EQ(node(centre, time), 3U) << time;
    EXPECT_NEAR(shoot({centre, 0, 0}, {0, 1, 0}, time).range_m, 5.0 + north, 1e-5) << time;
    EXPECT_EQ(node(centre - 0.49, time), 3U) << time;
    EXPECT_EQ(node(centre - 0.51, time), 9U) << time;
    EXPECT_EQ(node(centre + 0.49, time), 3U) << time;
    EXPECT_EQ(node(centre + 0.51, time), 9U) << time;
  }
}

TEST_F(RaysTest, WhatIsInMotionIsMetAsIfItStoodAndLeavesTheRestAlone) {
  const SyntheticForest f = make_forest(120, 60, 12);
  auto p = prototype_of(box_mesh({0.3F, 0.4F, 0.5F}, surface_of(0.5F)));
  const auto with_things = [&](bool moves, double x) {
    auto batches = batches_of(f);
    auto few = batch_of(p, {at(2, 1, 1), at(2, -1, 2)}, 7001, {x, 0, 0});
    std::vector<Instance> crowd;  // with a structure of its own
    for (int i = 0; i < 200; ++i)
      crowd.push_back(at(0.9F * static_cast<float>(i % 20) - 9, 0.9F * static_cast<float>(i / 20) - 9, 4));
    auto many = batch_of(p, crowd, 7002, {x, 0, 0});
    few->moves = many->moves = moves;
    batches.insert(batches.begin() + 1, {few, many});
    return batches;
  };
  const auto rays = all_round(6000, {0, 0, 2});
  const auto hidden_by = [&](EmbreeEngine& engine) {
    std::vector<std::uint8_t> hidden(rays.size());
    EXPECT_TRUE(engine.occluded({.rays = rays}, hidden));
    return hidden;
  };
  std::set<std::uint64_t> nodes;
  for (const double x : {0.0, 0.4, 5.0}) {
    show(with_things(true, x));
    EXPECT_EQ(engine_->statistics().rebuilt, x == 0 ? 5U : 0U);
    EXPECT_EQ(engine_->statistics().instances, 121U + 202U);
    const auto hits = cast(rays);
    for (const Hit& h : hits) nodes.insert(h.node.value);
    auto standing = make();
    ASSERT_TRUE(standing->prepare(window_of(with_things(false, x))));
    EXPECT_TRUE(equal_bytes(numbers(hits), numbers(cast(*standing, rays)))) << x;
    EXPECT_EQ(hidden_by(*engine_), hidden_by(*standing)) << x;
  }
  EXPECT_TRUE(nodes.contains(7001) && nodes.contains(7002) && nodes.size() > 20);
  // Asked for anew and in the same place, as another camera of the instant does; the first answer is gone.
  const auto there = numbers(cast(rays));
  show(with_things(true, 5));
  EXPECT_TRUE(equal_bytes(numbers(cast(rays)), there));
  show(with_things(true, 5.1));
  EXPECT_FALSE(equal_bytes(numbers(cast(rays)), there));
  // What moved is gone.
  show(batches_of(f));
  auto fresh = make();
  ASSERT_TRUE(fresh->prepare(window_of(batches_of(f))));
  EXPECT_TRUE(equal_bytes(numbers(cast(rays)), numbers(cast(*fresh, rays))));
}

TEST_F(RaysTest, WhatTurnsIsMetAtTheAngleInBetween) {
  auto p = prototype_of(box_mesh({2, 2, 0.5F}, surface_of(0.5F)));
  std::vector<ContentFrame> frames(2);
  for (std::size_t k = 0; k < 2; ++k) {
    Instance n = at(0, 0, 0);
    const float a = k == 0 ? 0.0F : 1.57079633F;
    turn(n, Eigen::Quaternionf(Eigen::AngleAxisf(a, Vector3f::UnitX())));
    frames[k].batches = {batch_of(p, {n}, 3)};
  }
  show(window_of(frames));
  // At a quarter of the way: 22.5 degrees about x; the top face is 0.5 m off the axis.
  for (const float time : {0.0F, 0.25F, 0.5F}) {
    const double a = static_cast<double>(time) * std::numbers::pi / 2;
    const Hit h = shoot({0, 0, 10}, {0, 0, -1}, time);
    EXPECT_NEAR(h.range_m, 10 - 0.5 / std::cos(a), 1e-4) << time;
    EXPECT_NEAR(h.cos_incidence, std::cos(a), 1e-5) << time;
    EXPECT_LT((normal_of(h).cast<double>() - Vector3d(0, -std::sin(a), std::cos(a))).norm(), 1e-5) << time;
  }
}

TEST_F(RaysTest, AHundredKilometresFromTheOriginIsAsGoodAsAtIt) {
  auto s = surface_of(0.5F);
  auto ground = plane_mesh(50, s);
  auto box = box_mesh({0.5F, 0.7F, 0.9F}, s);
  const auto world = [&](const Vector3d& at_m) {
    return std::vector<std::shared_ptr<const Batch>>{one(ground, 1, at_m),
                                                     one(box, 2, at_m + Vector3d(3, 1, 0.9))};
  };
  const auto rays = all_round(2000, {0, 0, 1.7});
  show(world(Vector3d::Zero()));
  const auto near = cast(rays);
  const Vector3d far(100000.3, -70000.7, 812.1);
  show(world(far));
  const auto away = cast(rays, far);
  std::size_t met = 0, differ = 0;
  for (std::size_t i = 0; i < rays.size(); ++i) {
    if (near[i].node.value != away[i].node.value) {
      ++differ;  // within a float of an edge
      continue;
    }
    if (near[i].nothing()) continue;
    ++met;
    // The ray is shot exactly (in double) at what is met: an ulp or two of the range, and of where the batch
    // stands in double.
    EXPECT_NEAR(near[i].range_m, away[i].range_m, 4e-7 * static_cast<double>(near[i].range_m) + 1e-9);
  }
  EXPECT_GT(met, 900U);
  EXPECT_LE(differ, 2U);
}

TEST_F(RaysTest, FiveCentimetresAndTenKilometresInOneView) {
  show({one(plane_mesh(0.02F, surface_of(0.5F)), 1, {0, 0, -0.05}),
        one(plane_mesh(20000, surface_of(0.5F)), 2, {0, 0, -10000})});
  EXPECT_NEAR(shoot({0, 0, 0}, {0, 0, -1}).range_m, 0.05, 1e-8);
  EXPECT_NEAR(shoot({1, 1, 0}, {0, 0, -1}).range_m, 10000, 1e-3);
}

TEST_F(RaysTest, InsideAThingOneSeesThroughItsOneSidedFacesAndMeetsTwoSidedOnes) {
  auto hull = surface_of(0.5F), cabin = surface_of(0.5F);
  cabin->two_sided = true;
  const auto wall = one(plane_mesh(50, surface_of(0.2F)), 2, {0, 0, -20});
  show({one(box_mesh({1, 1, 1}, hull), 1), wall});
  EXPECT_EQ(shoot({0, 0, 0}, {0, 0, -1}).node.value, 2U);
  EXPECT_EQ(shoot({0, 0, 5}, {0, 0, -1}).node.value, 1U);
  auto b = one(box_mesh({1, 1, 1}, cabin), 1);
  show({b, wall});
  const Hit h = shoot({0, 0, 0}, {0, 0, -1});
  EXPECT_EQ(h.node.value, 1U);
  EXPECT_NEAR(h.range_m, 1, 1e-6);
  EXPECT_EQ(normal_of(h), Vector3f(0, 0, 1)) << "towards the ray's origin";
  EXPECT_FLOAT_EQ(h.cos_incidence, 1);
}

TEST_F(RaysTest, TwoSurfacesInOnePlaceAreAlwaysChosenAlike) {
  auto a = one(plane_mesh(5, surface_of(0.2F)), 1), b = one(plane_mesh(5, surface_of(0.8F)), 2);
  const auto rays = all_round(2000, {0.1, 0.2, 3});
  show({a, b});
  const auto first = numbers(cast(rays));
  for (int i = 0; i < 3; ++i) {
    cache_ = *EmbreeCache::create();
    engine_ = make({.threads = i + 1});
    show({a, b});
    EXPECT_TRUE(equal_bytes(numbers(cast(rays)), first));
  }
}

TEST_F(RaysTest, WhatIsNotANumberIsLeftOutAndCounted) {
  auto bad = std::make_shared<Mesh>(*plane_mesh(1, surface_of(0.5F)));
  bad->vertices[2].position[1] = kNan;  // in both triangles
  auto degenerate = std::make_shared<Mesh>(*plane_mesh(1, surface_of(0.5F)));
  for (Vertex& v : degenerate->vertices) v.position[0] = 0;
  auto wrong = std::make_shared<Mesh>(*plane_mesh(1, surface_of(0.5F)));
  wrong->indices[4] = 4000000;
  auto cut = std::make_shared<Mesh>(*plane_mesh(1, surface_of(0.5F)));
  cut->parts[0].index_count = 600;
  for (Mesh* m : {bad.get(), degenerate.get(), wrong.get(), cut.get()}) m->serial = next_serial();
  auto good = prototype_of(plane_mesh(1, surface_of(0.5F)));
  Instance lost = at(0, 0, 0), flat = at(0, 0, 0), unturned = at(0, 0, 0);
  lost.position[1] = kNan;
  flat.scale[2] = 0;
  unturned.rotation[3] = 0;
  auto nowhere = one(plane_mesh(1, surface_of(0.5F)), 8, {kNan, 0, 0});
  auto headless = std::make_shared<Batch>();
  show({one(bad, 1), one(degenerate, 2), one(wrong, 3), one(cut, 4), nowhere, headless, nullptr,
        batch_of(good, {lost, flat, unturned}, 5), one(plane_mesh(1, surface_of(0.5F), -1), 7)});
  EXPECT_EQ(shoot({0.1, 0.3, 2}, {0, 0, -1}).node.value, 7U);
  EXPECT_EQ(engine_->statistics().left_out, 2U + 2U + 2U + 200U + 3U);

  Ray r = ray_of({0.1, 0.3, 2}, {0, 0, -1});
  for (float* v : {&r.direction[0], &r.origin[1], &r.time, &r.far_m}) {
    const float kept = *v;
    *v = kNan;
    EXPECT_TRUE(cast({r})[0].nothing());
    *v = kept;
  }
  EXPECT_FALSE(cast({r})[0].nothing());
  r.far_m = 2.5F;
  EXPECT_TRUE(cast({r})[0].nothing());
}

TEST_F(RaysTest, ASphereIsMetWithinWhatItsFacetsDiffer) {
  Mesh m;
  constexpr int kRings = 64, kSides = 128;
  for (int j = 0; j <= kRings; ++j)
    for (int i = 0; i <= kSides; ++i) {
      const double a = 2 * std::numbers::pi * i / kSides, b = std::numbers::pi * j / kRings;
      const Vector3f n(static_cast<float>(std::sin(b) * std::cos(a)),
                       static_cast<float>(std::sin(b) * std::sin(a)), static_cast<float>(std::cos(b)));
      m.vertices.push_back({{n.x(), n.y(), n.z()}, {n.x(), n.y(), n.z()}, {0, 0}, 0});
    }
  for (std::uint32_t j = 0; j < kRings; ++j)
    for (std::uint32_t i = 0; i < kSides; ++i) {
      const std::uint32_t a = j * (kSides + 1) + i, b = a + kSides + 1;
      for (const std::uint32_t k : {a, b, b + 1, a, b + 1, a + 1}) m.indices.push_back(k);
    }
  show({one(finished(std::move(m), surface_of(0.5F)), 1, {0, 4, 0})});
  // A facet of half angle h lies within 1 - cos(h) of the sphere; two directions, both of pi / 64.
  const double sag = 2 * (1 - std::cos(std::numbers::pi / 128));
  for (double x = -0.9; x < 0.95; x += 0.1) {
    const Hit h = shoot({x, 0, 0.05}, {0, 1, 0});
    const Vector3d n = Vector3d(x, -std::sqrt(1 - x * x - 0.0025), 0.05);
    const double steep = 1 / -n.y();
    ASSERT_FALSE(h.nothing()) << x;
    EXPECT_NEAR(h.range_m, 4 + n.y(), sag * steep + 1e-6) << x;
    EXPECT_LT((normal_of(h).cast<double>() - n).norm(), 2 * sag * steep + 0.003) << x;
    EXPECT_NEAR(h.cos_incidence, -n.y(), 0.003 * steep) << x;
  }
}

TEST_F(RaysTest, ACoarserLevelStandsWhereItsErrorIsAllowed) {
  auto p = std::make_shared<Prototype>();
  p->levels = {{box_mesh({1, 1, 1}, surface_of(0.2F)), 0},
               {box_mesh({0.9F, 0.9F, 0.9F}, surface_of(0.8F)), 0.1F}};
  engine_ = make({.allowed_error_rad = 0.005, .eye = Vector3d::Zero()});
  // 0.1 m subtends 5 mrad at 20 m, from the near side of a sphere of 1.73 m.
  show({batch_of(p, {at(0, 15, 0), at(0, -40, 0)}, 1)});
  EXPECT_FLOAT_EQ(shoot({0, 0, 0}, {0, 1, 0}).reflectance, 0.2F);
  EXPECT_FLOAT_EQ(shoot({0, 0, 0}, {0, -1, 0}).reflectance, 0.8F);
  // As near as the nearest eye within reach may come.
  engine_->set_options({.allowed_error_rad = 0.005, .eye = {0, 0, 0}, .eye_reach_m = 20});
  show({batch_of(p, {at(0, 15, 0), at(0, -40, 0)}, 1)});
  EXPECT_FLOAT_EQ(shoot({0, 0, 0}, {0, -1, 0}).reflectance, 0.2F);
  engine_->set_options({});
  show({batch_of(p, {at(0, 15, 0), at(0, -40, 0)}, 1)});
  EXPECT_FLOAT_EQ(shoot({0, 0, 0}, {0, -1, 0}).reflectance, 0.2F);
}

TEST_F(RaysTest, AProfileHasTheTimeOfWalksAndOfPreparingWhileItIsSetAndChangesNoHit) {
  const SyntheticForest f = make_forest(120, 60, 12);
  const auto rays = all_round(5000, {0, 0, 2});
  const auto profile = std::make_shared<RayProfile>();
  engine_->set_profile(profile);
  show(batches_of(f));
  EXPECT_GT(profile->prepare_ns, 0);
  EXPECT_EQ(profile->walk_ns, 0);
  const auto timed = numbers(cast(rays));
  const std::int64_t walked_ns = profile->walk_ns, prepared_ns = profile->prepare_ns;
  EXPECT_GT(walked_ns, 0);
  engine_->set_profile(nullptr);
  EXPECT_TRUE(equal_bytes(numbers(cast(rays)), timed));
  show(batches_of(f));
  EXPECT_EQ(profile->walk_ns, walked_ns);
  EXPECT_EQ(profile->prepare_ns, prepared_ns);
}

TEST_F(RaysTest, QueriesThatMakeNoSenseAreRefused) {
  std::vector<Hit> hits(1);
  const std::vector<Ray> rays(1);
  EXPECT_EQ(engine_->cast({.rays = rays}, hits).error().code, ErrorCode::bad_input) << "nothing prepared";
  show(std::vector<std::shared_ptr<const Batch>>{});
  EXPECT_EQ(engine_->cast({.band = 6, .rays = rays}, hits).error().code, ErrorCode::bad_input);
  EXPECT_EQ(engine_->cast({.band = -1, .rays = rays}, hits).error().code, ErrorCode::bad_input);
  hits.resize(2);
  EXPECT_EQ(engine_->cast({.rays = rays}, hits).error().code, ErrorCode::bad_input);
  EXPECT_EQ(engine_->prepare(nullptr).error().code, ErrorCode::bad_input);
  const Vector3d nowhere(std::nan(""), 0, 0);
  hits.resize(1);
  EXPECT_EQ(engine_->cast({.origin = nowhere, .rays = rays}, hits).error().code, ErrorCode::bad_input);
}

}  // namespace
}  // namespace rigor::test
