#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <limits>
#include <set>

#include "sim/nature/providers.h"
#include "sim/render/content/world_view.h"
#include "sim/world/semantic_types.h"
#include "tests/sim/nature/built/mesh_checks.h"

namespace rigor::nature {
namespace {

using Eigen::Vector3d;
using render::Batch;
using render::ContentFrame;
using testing::HasSubstr;
using world::NodeId;
using world::Numbers;
const double kNaN = std::numeric_limits<double>::quiet_NaN();

struct Ground final : render::GroundHeights {
  std::function<double(double, double)> z = [](double, double) { return kNaN; };
  [[nodiscard]] double height_at(double x, double y) const override { return z(x, y); }
  [[nodiscard]] Vector3d normal_at(double, double) const override { return Vector3d::UnitZ(); }
};

class Built : public testing::Test {
 protected:
  Built() {
    EXPECT_TRUE(world::define_semantic_types(*db));
    std::vector<std::shared_ptr<render::ContentProvider>> providers;
    providers.push_back(make_built_provider(ground, "."));
    view = std::make_unique<render::WorldView>(*db, std::move(providers));
  }
  NodeId add(std::string_view type, const std::vector<std::pair<std::string, world::Value>>& values) {
    auto tx = db->begin();
    const NodeId node = *tx.create(type);
    for (const auto& [name, value] : values) {
      const auto s = tx.set(node, name, value);
      EXPECT_TRUE(s) << (s ? "" : s.error().text());
    }
    EXPECT_TRUE(tx.commit());
    return node;
  }
  void set(NodeId node, const std::string& name, world::Value value) {
    auto tx = db->begin();
    EXPECT_TRUE(tx.set(node, name, std::move(value)));
    EXPECT_TRUE(tx.commit());
  }
  std::vector<std::shared_ptr<const Batch>> of(NodeId node) {
    std::vector<std::shared_ptr<const Batch>> out;
    for (const auto& b : view->collect({}).batches)
      if (b->node == node) out.push_back(b);
    return out;
  }
  NodeId house(double x, double y, double side = 10) {
    return add("Building", {{"footprint", Numbers{x, y, x + side, y, x + side, y + side, x, y + side}},
                            {"roof_shape", std::string("gabled")}});
  }
  NodeId terrain(float z) {
    auto tx = db->begin();
    const NodeId node = *tx.create("Terrain");
    EXPECT_TRUE(tx.set(node, "columns", std::int64_t{101}));
    EXPECT_TRUE(tx.set(node, "rows", std::int64_t{101}));
    EXPECT_TRUE(tx.set(node, "y_m", 100.0));
    heights.assign(101UL * 101, z);
    EXPECT_TRUE(tx.set(node, "heights_m", world::Blob::of(std::span<const float>(heights))));
    EXPECT_TRUE(tx.commit());
    return node;
  }

  std::unique_ptr<world::Database> db = world::Database::create();
  std::shared_ptr<Ground> ground = std::make_shared<Ground>();
  std::unique_ptr<render::WorldView> view;
  std::vector<float> heights;
};

TEST_F(Built, EveryNodeHasItsOwnBatchesAndOnlyAChangedOneIsRemade) {
  const NodeId a = house(0, 0), b = house(30, 0);
  const NodeId road = add("Road", {{"line", Numbers{0, -10, 60, -10}}});
  const NodeId fence = add("Fence", {{"line", Numbers{0, -6, 20, -6}}});
  const NodeId pole = add("Pole", {{"position", Vector3d(5, -7, kNaN)}});
  std::map<NodeId, std::set<std::uint64_t>> before;
  for (const NodeId n : {a, b, road, fence, pole})
    for (const auto& batch : of(n)) before[n].insert(batch->serial);
  EXPECT_EQ(before.size(), 5U);
  set(a, "height_m", 9.0);
  for (const NodeId n : {a, b, road, fence, pole}) {
    std::set<std::uint64_t> now;
    for (const auto& batch : of(n)) now.insert(batch->serial);
    EXPECT_EQ(now == before[n], n != a);
  }
  EXPECT_GT(of(a).front()->bounds.max().z(), 11.9);
  const auto same = of(b).front()->serial;
  set(b, "name", std::string("town hall"));
  EXPECT_EQ(of(b).front()->serial, same) << "a name changes nothing that is seen";
  auto tx = db->begin();
  ASSERT_TRUE(tx.remove(a));
  ASSERT_TRUE(tx.commit());
  EXPECT_TRUE(of(a).empty());
  EXPECT_EQ(of(b).size(), 1U);
}

TEST_F(Built, ChangedGroundRemakesWhatStandsOnItAlone) {
  ground->z = [this](double x, double y) {
    const auto c = static_cast<int>(std::floor(x)), r = static_cast<int>(std::floor(100 - y));
    if (c < 0 || r < 0 || c > 100 || r > 100) return kNaN;
    return static_cast<double>(heights[static_cast<std::size_t>(r * 101 + c)]);
  };
  const NodeId land = terrain(5);
  const NodeId west = house(10, 40), east = house(70, 40);
  EXPECT_NEAR(of(west).front()->origin.z(), 5, 1e-6);
  const auto serial_west = of(west).front()->serial, serial_east = of(east).front()->serial;
  for (std::size_t r = 0; r < 101; ++r)
    for (std::size_t c = 60; c < 101; ++c) heights[r * 101 + c] = 2;
  set(land, "heights_m", world::Blob::of(std::span<const float>(heights)));
  EXPECT_EQ(of(west).front()->serial, serial_west);
  EXPECT_NE(of(east).front()->serial, serial_east);
  EXPECT_NEAR(of(east).front()->origin.z(), 2, 1e-6);
}

TEST_F(Built, AChangedMaterialIsSeen) {
  const NodeId node = house(0, 0);
  const NodeId paint = add("Material", {{"reflectance", Numbers{0.1, 0.2, 0.3, 0.4, 0.5, 0.6}}});
  auto tx = db->begin();
  ASSERT_TRUE(tx.connect(node, db->schema().require_edge("made_of"), paint));
  ASSERT_TRUE(tx.commit());
  const auto wall = [&] {
    std::set<float> reds;
    for (const auto& part : of(node).front()->prototype->levels.front().mesh->parts)
      reds.insert(part.surface->reflectance[0]);
    return reds;
  };
  EXPECT_TRUE(wall().contains(0.1F));
  set(paint, "reflectance", Numbers{0.7, 0.2, 0.3, 0.4, 0.5, 0.6});
  EXPECT_TRUE(wall().contains(0.7F));
  EXPECT_FALSE(wall().contains(0.1F));
}

TEST_F(Built, WhatCannotBeShownIsNamed) {
  add("Building", {{"name", std::string("ruin")}});
  add("Building", {{"footprint", Numbers{0, 0, 10, 10, 10, 0, 0, 10}}});
  add("Building", {{"footprint", Numbers{0, 0, 10, 0, 10, 10, 0, 10}},
                   {"roof_shape", std::string("gabled")},
                   {"holes", Numbers{6, 20, 20, 21, 20, 20, 21}}});
  const NodeId road = add("Road", {{"line", Numbers{1, 1}}});
  add("Fence", {{"line", Numbers{1, 1, 1, 1}}});
  const auto warnings = view->warnings();
  ASSERT_EQ(warnings.size(), 5U);
  EXPECT_THAT(warnings[0], HasSubstr("(ruin)"));
  EXPECT_THAT(warnings[1], HasSubstr("crosses itself"));
  EXPECT_THAT(warnings[2], HasSubstr("hole 0"));
  EXPECT_THAT(warnings[3], HasSubstr("Road " + std::to_string(road.value)));
  EXPECT_EQ(view->collect({}).batches.size(), 1U) << "the house with the bad hole is shown";
  set(road, "line", Numbers{1, 1, 50, 1});
  EXPECT_EQ(view->warnings().size(), 4U);
}

TEST_F(Built, StandsOnTheLowestGroundAndReachesIntoIt) {
  ground->z = [](double x, double) { return 100 + 0.3 * x; };
  const NodeId node = house(0, 0);
  const auto batch = of(node).front();
  EXPECT_NEAR(batch->origin.z(), 100, 0.01);
  EXPECT_LT(batch->bounds.min().z(), 99.5);
  const NodeId high =
      add("Building", {{"footprint", Numbers{0, 30, 10, 30, 10, 40, 0, 40}}, {"base_m", 104.0}});
  EXPECT_NEAR(of(high).front()->origin.z(), 104, 1e-9);
  EXPECT_LT(of(high).front()->bounds.min().z(), 99.5) << "its walls reach the ground";
}

TEST_F(Built, WithoutTerrainEverythingStandsAtZero) {
  EXPECT_NEAR(of(house(0, 0)).front()->origin.z(), 0, 1e-12);
  const NodeId pole = add("Pole", {{"position", Vector3d(5, -7, kNaN)}, {"height_m", 6.0}});
  EXPECT_NEAR(of(pole).front()->bounds.max().z(), 6, 1e-5);
  const NodeId road = add("Road", {{"line", Numbers{0, -10, 60, -10}}});
  EXPECT_NEAR(of(road).front()->bounds.max().z(), 0.04 + 0.0625, 1e-3);
}

// 100 km out a float has steps of 8 mm; the batch's origin must take that away.
TEST_F(Built, FarFromTheOriginIsAsPreciseAsNearIt) {
  const NodeId near = add("Building", {{"footprint", Numbers{0.3, 0.1, 12.45, 0.1, 12.45, 8.37, 0.3, 8.37}}});
  const NodeId far = add("Building", {{"footprint", Numbers{100000.3, -99999.9, 100012.45, -99999.9,
                                                            100012.45, -99991.63, 100000.3, -99991.63}}});
  const auto a = of(near).front(), b = of(far).front();
  EXPECT_NEAR(test::volume_m3(*a->prototype->levels.back().mesh),
              test::volume_m3(*b->prototype->levels.back().mesh), 0.01);
  EXPECT_NEAR(b->bounds.max().x() - 100000, a->bounds.max().x(), 1e-4);
  EXPECT_LT(b->prototype->levels[0].mesh->bounds.sizes().maxCoeff(), 20);
}

TEST_F(Built, FencePostsAreInstancedAtTheirSpacing) {
  ground->z = [](double x, double) { return 0.1 * x; };
  const NodeId node =
      add("Fence", {{"line", Numbers{0, 0, 25, 0, 25, 10}}, {"post_spacing_m", 2.5}, {"height_m", 1.5}});
  const auto wire = of(node);
  ASSERT_EQ(wire.size(), 2U);
  EXPECT_EQ(wire[0]->instances.size(), 11U + 4U);
  EXPECT_EQ(wire[1]->instances.size(), 4U * 14U);
  const auto& last = wire[0]->instances.back();
  EXPECT_NEAR(last.position[2] + last.scale[2] + wire[0]->origin.z(), 2.5 + 1.5, 1e-4)
      << "top of the last post";
  // A wire runs from post to post: its rod's end is the next one's start.
  const auto end_of = [&](const render::Instance& i) -> Vector3d {
    const Eigen::Quaterniond q(i.rotation[3], i.rotation[0], i.rotation[1], i.rotation[2]);
    return Vector3d(i.position[0], i.position[1], i.position[2]) + q * Vector3d(0, 0, i.scale[2]);
  };
  const auto& next = wire[1]->instances[4];
  EXPECT_LT(
      (end_of(wire[1]->instances[0]) - Vector3d(next.position[0], next.position[1], next.position[2])).norm(),
      1e-4);
  set(node, "style", std::string("boards"));
  EXPECT_GT(of(node)[1]->instances.size(), 180U);
  set(node, "style", std::string("rails"));
  EXPECT_EQ(of(node)[1]->instances.size(), 3U * 14U);
}

TEST_F(Built, RebuiltFromTheSameWorldIsTheSame) {
  house(0, 0);
  add("Road", {{"line", Numbers{0, -10, 30, -10, 60, -40}}, {"width_m", 7.0}});
  const auto first = view->collect({});
  const auto other = make_built_provider(ground, ".");
  other->rebuild(db->snapshot());
  ContentFrame second;
  other->collect({}, second);
  ASSERT_EQ(first.batches.size(), second.batches.size());
  for (std::size_t i = 0; i < first.batches.size(); ++i) {
    const auto &a = *first.batches[i]->prototype->levels[0].mesh,
               &b = *second.batches[i]->prototype->levels[0].mesh;
    EXPECT_EQ(a.indices, b.indices);
    ASSERT_EQ(a.vertices.size(), b.vertices.size());
    EXPECT_EQ(std::memcmp(a.vertices.data(), b.vertices.data(), a.vertices.size() * sizeof(render::Vertex)),
              0);
  }
}

TEST_F(Built, OnlyWhatMayBeSeenIsCollected) {
  house(0, 0);
  house(1000, 0);
  render::ContentQuery query;
  query.far_m = 100;
  EXPECT_EQ(view->collect(query).batches.size(), 1U);
}

}  // namespace
}  // namespace rigor::nature
