#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <cstdio>

#include "sim/nature/trees/allometry.h"
#include "sim/nature/trees/stem_shape.h"
#include "sim/nature/trees/tree_mesh.h"
#include "tests/sim/nature/trees/tree_world.h"

namespace rigor {
namespace {

using test::TreeWorld;
using testing::ElementsAre;
using testing::HasSubstr;
using world::NodeId;

bool is_crown(const render::Batch& b) { return b.prototype->name.find("crown") != std::string::npos; }

struct Seen {
  double top_m = -1e9, foot_m = 1e9, reach_m = 0, radius_at_breast_m = 0;
  int trunks = 0, crowns = 0;
};
/// A tree as its instances show it: z above `ground_m`, reach from (x, y).
Seen look_at(const render::ContentFrame& frame, NodeId node, double x, double y, double ground_m) {
  Seen s;
  for (const auto& b : frame.batches)
    for (std::size_t i = 0; i < b->instances.size(); ++i) {
      if (b->nodes.at(i) != node) continue;
      const bool crown = is_crown(*b);
      (crown ? s.crowns : s.trunks) += 1;
      std::vector<double> reach;
      for (const Eigen::Vector3d& p : test::corners_of(*b, i)) {
        EXPECT_TRUE(b->bounds.contains(p));
        s.top_m = std::max(s.top_m, p.z() - ground_m);
        if (!crown) s.foot_m = std::min(s.foot_m, p.z() - ground_m);
        reach.push_back(std::hypot(p.x() - x, p.y() - y));
      }
      if (crown) {
        std::sort(reach.begin(), reach.end());
        s.reach_m = reach[reach.size() * 98 / 100];
        continue;
      }
      // Cut the trunk at 1.3 m: half of the largest width of the section, both ways averaged.
      const auto& m = *b->prototype->levels.front().mesh;
      const auto c = test::corners_of(*b, i);
      double x0 = 1e9, x1 = -1e9, y0 = 1e9, y1 = -1e9;
      for (std::size_t k = 0; k < m.indices.size(); ++k) {
        const Eigen::Vector3d &p = c[m.indices[k]], &q = c[m.indices[k % 3 == 2 ? k - 2 : k + 1]];
        const double zp = p.z() - ground_m - 1.3, zq = q.z() - ground_m - 1.3;
        if ((zp < 0) == (zq < 0)) continue;
        const Eigen::Vector3d at = p + (q - p) * (zp / (zp - zq));
        x0 = std::min(x0, at.x()), x1 = std::max(x1, at.x()), y0 = std::min(y0, at.y()),
        y1 = std::max(y1, at.y());
      }
      s.radius_at_breast_m = 0.25 * (x1 - x0 + y1 - y0);
    }
  return s;
}

TEST(TreeProvider, ShowsNothingOfAnEmptyWorld) {
  TreeWorld w;
  EXPECT_TRUE(w.frame().batches.empty());
  EXPECT_TRUE(w.provider->warnings().empty());
  // Nor of a world without the types.
  auto bare = world::Database::create();
  auto provider = nature::make_tree_provider(nullptr);
  provider->rebuild(bare->snapshot());
  render::ContentFrame frame;
  provider->collect({}, frame);
  EXPECT_TRUE(frame.batches.empty());
}

TEST(TreeProvider, EveryTreeHasItsOwnSize) {
  for (const char* species :
       {"TSHE", "ABAM", "PSME", "THPL", "TABR", "Picea", "Pinus", "Larix", "Fagus", "Quercus", "Betula"})
    for (const double dbh_m : {0.05, 0.12, 0.3, 0.7, 1.4, 3.0}) {
      TreeWorld w;
      const NodeId n = w.plant_one({.x = 12, .y = -40, .species = species, .dbh_m = dbh_m});
      const auto size = nature::size_of(*nature::find_species(species).species, {.dbh_m = dbh_m});
      const Seen s = look_at(w.frame(), n, 12, -40, w.ground->height_at(12, -40));
      const std::string what = std::string(species) + " " + std::to_string(dbh_m);
      EXPECT_EQ(s.trunks, 1);
      EXPECT_EQ(s.crowns, 1);
      EXPECT_NEAR(s.radius_at_breast_m / (0.5 * dbh_m), 1, 0.1) << what;
      EXPECT_NEAR(s.top_m / size.height_m, 1, 0.06) << what;
      EXPECT_LE(s.foot_m, 0) << what;
      EXPECT_NEAR(s.reach_m / size.crown_radius_m, 1, 0.15) << what;
    }
}

TEST(TreeProvider, MeasuredCrownsAreShown) {
  TreeWorld w;
  const NodeId n = w.plant_one(
      {.x = 3, .y = 4, .z = 100, .dbh_m = 0.5, .height_m = 20, .crown_radius_m = 5, .crown_base_m = 6});
  const Seen s = look_at(w.frame(), n, 3, 4, 100);
  EXPECT_NEAR(s.top_m, 20, 0.6);
  EXPECT_NEAR(s.reach_m, 5, 0.6);
}

TEST(TreeProvider, FarFromTheOriginNothingShakes) {
  TreeWorld w;
  w.ground->half_m = 1e9;
  w.ground->slope = 0;
  const NodeId n = w.plant_one({.x = 5e5 + 0.25, .y = -4e6 + 0.5});
  const Seen s = look_at(w.frame(), n, 5e5 + 0.25, -4e6 + 0.5, 5);
  EXPECT_NEAR(s.radius_at_breast_m, 0.2, 0.02);
}

TEST(TreeProvider, OneChangedTreeRemakesItsTileAlone) {
  TreeWorld w;
  std::vector<TreeWorld::Spec> specs;
  for (int i = 0; i < 20; ++i)
    for (int j = 0; j < 20; ++j)
      specs.push_back({.x = 12.0 * i,
                       .y = 12.0 * j,
                       .species = (i + j) % 2 ? "TSHE" : "ABAM",
                       .dbh_m = 0.05 + 0.002 * i * j});
  const auto nodes = w.plant(specs);
  const auto before = w.frame();
  std::set<std::uint64_t> old;
  for (const auto& b : before.batches) old.insert(b->serial);
  auto tx = w.db->begin("cut");
  ASSERT_TRUE(tx.remove(nodes[137]));
  ASSERT_TRUE(tx.commit());
  std::size_t fresh = 0, shown = 0;
  for (const auto& b : w.frame().batches) {
    fresh += !old.count(b->serial);
    shown += b->instances.size();
    EXPECT_EQ(std::count(b->nodes.begin(), b->nodes.end(), nodes[137]), 0);
    EXPECT_EQ(b->nodes.size(), b->instances.size());
  }
  EXPECT_EQ(shown, 2 * (specs.size() - 1));
  EXPECT_LE(fresh, 2u);  // its trunk's and its crown's batch
}

TEST(TreeProvider, FollowsEditsAsIfBuiltAnew) {
  TreeWorld w;
  std::vector<TreeWorld::Spec> specs;
  for (int i = 0; i < 60; ++i) specs.push_back({.x = 3.0 * i, .y = 1.0 * (i % 7), .dbh_m = 0.1 + 0.01 * i});
  const auto nodes = w.plant(specs);
  auto tx = w.db->begin("edit");
  ASSERT_TRUE(tx.set(nodes[5], w.tree->species, std::string("Fagus")));
  ASSERT_TRUE(tx.set(nodes[6], w.tree->position, world::Vector3(500, 20, NAN)));
  ASSERT_TRUE(tx.set(nodes[7], w.tree->dead, true));
  ASSERT_TRUE(tx.set(nodes[8], w.tree->dbh_m, 1.9));
  ASSERT_TRUE(tx.remove(nodes[9]));
  ASSERT_TRUE(tx.set(nodes[10], w.tree->heading_rad, 1.0));
  ASSERT_TRUE(tx.commit());
  const auto check = [&] {
    auto anew = nature::make_tree_provider(w.ground);
    anew->rebuild(w.db->snapshot());
    render::ContentFrame a = w.frame(), b;
    anew->collect({}, b);
    ASSERT_EQ(a.batches.size(), b.batches.size());
    for (std::size_t i = 0; i < a.batches.size(); ++i) {
      const auto &x = *a.batches[i], &y = *b.batches[i];
      EXPECT_EQ(x.prototype, y.prototype);
      EXPECT_EQ(x.origin, y.origin);
      EXPECT_EQ(x.nodes, y.nodes);
      ASSERT_EQ(x.instances.size(), y.instances.size());
      EXPECT_EQ(
          std::memcmp(x.instances.data(), y.instances.data(), x.instances.size() * sizeof(render::Instance)),
          0);
    }
  };
  check();
  ASSERT_TRUE(w.db->undo());
  check();
  ASSERT_TRUE(w.db->redo());
  check();
}

TEST(TreeProvider, ANewNameChangesNothing) {
  TreeWorld w;
  const NodeId n = w.plant_one({});
  const auto before = w.serials();
  auto tx = w.db->begin("name");
  ASSERT_TRUE(tx.set(n, w.tree->name, std::string("the old hemlock")));
  ASSERT_TRUE(tx.commit());
  EXPECT_EQ(w.serials(), before);
}

TEST(TreeProvider, ChangedTerrainMovesOnlyTreesWhoseGroundMoved) {
  TreeWorld w;
  const auto nodes = w.plant({{.x = -200, .y = 0}, {.x = 200, .y = 0}, {.x = 300, .y = 0, .z = 7}});
  const auto before = w.serials();
  w.ground->step_at_m = 0;
  w.ground->step_m = 3;
  const world::types::Terrain terrain(w.db->schema());
  auto tx = w.db->begin("terrain");
  ASSERT_TRUE(tx.create(terrain.type));
  ASSERT_TRUE(tx.commit());
  const auto frame = w.frame();
  std::size_t kept = 0;
  for (const auto& b : frame.batches) kept += before.count(b->serial);
  EXPECT_EQ(frame.batches.size(), 6u);
  EXPECT_EQ(kept, 4u);  // the trees at −200 and, with a z of its own, at 300
  EXPECT_NEAR(look_at(frame, nodes[1], 200, 0, 28).radius_at_breast_m, 0.2, 0.02);
}

TEST(TreeProvider, WarnsOncePerCodeAndShowsTheTreeAllTheSame) {
  TreeWorld w;
  w.plant({{.x = 1, .species = "XXXX"}, {.x = 5, .species = "XXXX"}, {.x = 9, .species = ""}});
  EXPECT_THAT(w.provider->warnings(), ElementsAre(HasSubstr("without species"),
                                                  testing::AllOf(HasSubstr("XXXX"), HasSubstr("2 trees"))));
  std::size_t shown = 0;
  for (const auto& b : w.frame().batches) shown += b->instances.size();
  EXPECT_EQ(shown, 6u);
}

TEST(TreeProvider, ATreeWithoutSizeIsASeedlingWithAWarning) {
  TreeWorld w;
  const NodeId n = w.plant_one({.x = 0, .y = 0, .z = 0, .dbh_m = 0});
  EXPECT_THAT(w.provider->warnings(), ElementsAre(HasSubstr("seedling")));
  const Seen s = look_at(w.frame(), n, 0, 0, 0);
  EXPECT_GT(s.top_m, 0.2);
  EXPECT_LT(s.top_m, 1);
}

TEST(TreeProvider, OutsideTheTerrainATreeStandsAtZeroWithAWarning) {
  TreeWorld w;
  const NodeId n = w.plant_one({.x = 5000, .y = 0});
  EXPECT_THAT(w.provider->warnings(), ElementsAre(HasSubstr("outside the terrain")));
  EXPECT_NEAR(look_at(w.frame(), n, 5000, 0, 0).radius_at_breast_m, 0.2, 0.02);
}

TEST(TreeProvider, SnagsStandWithoutCrowns) {
  TreeWorld w;
  const NodeId n = w.plant_one({.x = 0, .y = 0, .z = 0, .dbh_m = 0.8, .dead = true});
  const Seen s = look_at(w.frame(), n, 0, 0, 0);
  EXPECT_EQ(s.crowns, 0);
  EXPECT_EQ(s.trunks, 1);
  EXPECT_NEAR(s.radius_at_breast_m, 0.4, 0.04);
  EXPECT_GT(s.top_m, 15);
}

TEST(TreeProvider, CollectsWhatMayBeSeen) {
  TreeWorld w;
  w.plant({{.x = -100}, {.x = 100}});
  render::ContentQuery east;
  east.frustum.emplace_back(Eigen::Vector3d(1, 0, 0), 0.0);
  render::ContentFrame frame;
  w.provider->collect(east, frame);
  ASSERT_EQ(frame.batches.size(), 2u);
  for (const auto& b : frame.batches) EXPECT_GT(b->bounds.min().x(), 0);
}

TEST(TreeProvider, LoadsAHundredThousandTreesAndCutsOneAtOnce) {
  TreeWorld w;
  w.ground->half_m = 1e6;
  constexpr int kSide = 317;
  std::vector<TreeWorld::Spec> specs;
  const char* codes[] = {"ABAM", "TSHE", "CANO", "TSME", "THPL", "PSME", "TABR", "Picea"};
  for (int i = 0; i < kSide; ++i)
    for (int j = 0; j < kSide; ++j)
      specs.push_back({.x = 3.7 * i,
                       .y = 3.7 * j,
                       .species = codes[(i * 7 + j * 13) % 8],
                       .dbh_m = 0.05 + 0.012 * ((i * 31 + j * 17) % 100)});
  w.subscription.end();
  const auto nodes = w.plant(specs);
  const auto clock = [] { return std::chrono::steady_clock::now(); };
  const auto ms = [](auto a, auto b) { return std::chrono::duration<double, std::milli>(b - a).count(); };
  const auto t0 = clock();
  w.provider->rebuild(w.db->snapshot());
  const auto t1 = clock();
  w.provider->rebuild(w.db->snapshot());
  const auto t2 = clock();
  const std::size_t batches = w.frame().batches.size();
  const auto t3 = clock();
  double slowest = 0, all = 0;
  w.subscription = w.db->subscribe({}, [&](const world::ChangeSet& set, std::span<const world::Change>) {
    const auto a = clock();
    w.provider->apply(set);
    const double took = ms(a, clock());
    slowest = std::max(slowest, took), all += took;
  });
  for (int k = 0; k < 50; ++k) {
    auto tx = w.db->begin("fell");
    ASSERT_TRUE(tx.remove(nodes[static_cast<std::size_t>(k) * 1999]));
    ASSERT_TRUE(tx.commit());
  }
  std::printf(
      "%zu trees: first build %.0f ms (prototypes among it), again %.0f ms; %zu batches collected in %.2f "
      "ms; one felled %.3f ms (slowest %.3f)\n",
      specs.size(), ms(t0, t1), ms(t1, t2), batches, ms(t2, t3), all / 50, slowest);
  std::size_t shown = 0;
  for (const auto& b : w.frame().batches) shown += b->instances.size();
  EXPECT_EQ(shown, 2 * (specs.size() - 50));
}

/// A stem's mesh, cut level: the middle of the cut's outline, and twice the mean distance from it. Each piece
/// of the outline counts by its length, so that it does not matter how the mesh is divided into triangles.
nature::StemSection cut_of(const render::ContentFrame& frame, NodeId node, double z) {
  std::vector<std::pair<Eigen::Vector2d, Eigen::Vector2d>> outline;
  for (const auto& b : frame.batches)
    for (std::size_t i = 0; i < b->instances.size(); ++i) {
      if (b->nodes.at(i) != node || is_crown(*b)) continue;
      const auto& m = *b->prototype->levels.front().mesh;
      const auto c = test::corners_of(*b, i);
      for (std::size_t k = 0; k + 2 < m.indices.size(); k += 3) {
        std::vector<Eigen::Vector2d> met;
        for (std::size_t e = 0; e < 3; ++e) {
          const Eigen::Vector3d &p = c[m.indices[k + e]], &q = c[m.indices[k + (e + 1) % 3]];
          if ((p.z() < z) != (q.z() < z))
            met.push_back((p + (q - p) * ((z - p.z()) / (q.z() - p.z()))).head<2>());
        }
        if (met.size() == 2) outline.emplace_back(met[0], met[1]);
      }
    }
  Eigen::Vector2d middle = Eigen::Vector2d::Zero();
  double length = 0, radius = 0;
  for (const auto& [p, q] : outline) middle += (p + q) / 2 * (q - p).norm(), length += (q - p).norm();
  middle /= length;
  for (const auto& [p, q] : outline)
    radius += ((p - middle).norm() + (q - middle).norm()) / 2 * (q - p).norm() / length;
  return {middle.x(), middle.y(), 2 * radius};
}

TEST(TreeProvider, AStemsSectionIsThatOfItsMesh) {
  TreeWorld w;
  const auto nodes = w.plant(
      {{3, -4, 7, "TSHE", 0.4}, {20, 5, 7, "FASY", 0.5}, {-8, 2, 7, "THPL", 0.9}, {0, 9, 7, "PIAB", 0.3}});
  const auto frame = w.frame();
  const auto snapshot = w.db->snapshot();
  double farthest = 0;
  for (const NodeId n : nodes)
    for (const double height : {0.5, 0.8, 2.0}) {
      const auto section = nature::stem_section(snapshot, *w.tree, n, height);
      ASSERT_TRUE(section);
      const nature::StemSection cut = cut_of(frame, n, 7 + height);
      EXPECT_NEAR(section->x_m, cut.x_m, 0.01) << n.value << " at " << height;
      EXPECT_NEAR(section->y_m, cut.y_m, 0.01);
      EXPECT_NEAR(section->diameter_m, cut.diameter_m, 0.03 * cut.diameter_m);
      const world::Vector3& foot = *snapshot.get(n, w.tree->position);
      farthest = std::max(farthest, std::hypot(section->x_m - foot.x(), section->y_m - foot.y()));
    }
  EXPECT_GT(farthest, 0.02) << "no stem here is straight: the middle of the cut proves something";
  EXPECT_FALSE(nature::stem_section(snapshot, *w.tree, nodes[0], 80)) << "higher than the tree";
}

}  // namespace
}  // namespace rigor
