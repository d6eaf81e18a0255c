// Queries of space against looking at every node: crowds, coincident places, far from the origin, moving.
#include <gtest/gtest.h>

#include <random>

#include "sim/world/graph/database.h"

namespace rigor::world {
namespace {

class GraphSpace : public testing::Test {
 protected:
  GraphSpace() {
    type = *db->define(TypeSpec{
        .name = "Dot",
        .attributes = {{.name = "position", .default_value = Vector3(0, 0, 0), .nan_is_unknown = true}},
        .place_attribute = "position"});
    position = db->schema().require<Vector3>("Dot", "position");
  }
  void check(const Vector3& centre, double radius_m, std::size_t k) {
    const Snapshot s = db->snapshot();
    std::vector<std::pair<double, NodeId>> all;
    std::vector<NodeId> box, near;
    const Box3 around{centre.array() - radius_m, centre.array() + radius_m / 2};
    s.scan(type, position, [&](std::span<const NodeId> ids, std::span<const Vector3> p) {
      for (std::size_t i = 0; i < ids.size(); ++i) {
        if (!p[i].allFinite()) continue;
        all.emplace_back((p[i] - centre).norm(), ids[i]);
        if ((p[i].array() >= around.min.array()).all() && (p[i].array() <= around.max.array()).all())
          box.push_back(ids[i]);
      }
    });
    std::sort(all.begin(), all.end());
    std::sort(box.begin(), box.end());
    for (const auto& [d, n] : all)
      if (d <= radius_m) near.push_back(n);
    ASSERT_EQ(s.in_radius(type, centre, radius_m), near);
    ASSERT_EQ(s.in_box(type, around), box);
    near.clear();
    for (std::size_t i = 0; i < std::min(k, all.size()); ++i) near.push_back(all[i].second);
    ASSERT_EQ(s.nearest(type, centre, k), near);
  }
  std::unique_ptr<Database> db = Database::create({.undo_steps = 0});
  TypeId type;
  Attribute<Vector3> position;
};

TEST_F(GraphSpace, AgreesWithLookingAtEveryNodeWhileTheyMove) {
  std::mt19937_64 random(9);
  std::uniform_real_distribution<double> u(0, 1);
  const Vector3 origins[] = {{0, 0, 0}, {-3e5, 5e6, 120}, {4e11, -4e11, 0}, {1e150, 0, 0}};
  const auto place = [&]() -> Vector3 {
    const auto r = random() % 100;
    if (r == 0) return Vector3::Constant(std::numeric_limits<double>::quiet_NaN());
    if (r < 10) return origins[1];  // a crowd on one spot
    return origins[random() % 4] + Vector3(u(random) * 200, u(random) * 200, u(random) * 3);
  };
  std::vector<NodeId> nodes;
  for (int round = 0; round < 25; ++round) {
    Transaction tx = db->begin();
    for (int i = 0; i < 200; ++i) {
      nodes.push_back(*tx.create(type));
      ASSERT_TRUE(tx.set(nodes.back(), position, place()));
    }
    for (int i = 0; i < 200; ++i) {
      const std::size_t k = random() % nodes.size();
      if (i % 4 == 0 && nodes.size() > 100) {
        ASSERT_TRUE(tx.remove(nodes[k]));
        nodes[k] = nodes.back();
        nodes.pop_back();
      } else if (i % 4 == 1) {
        const Vector3 p = *tx.get(nodes[k], position);  // a small step
        ASSERT_TRUE(tx.set(nodes[k], position, Vector3(p + Vector3(0.01, 0.02, 0))));
      } else {
        ASSERT_TRUE(tx.set(nodes[k], position, place()));
      }
    }
    ASSERT_TRUE(tx.commit());
    for (int q = 0; q < 12; ++q) {
      const Vector3* p = db->snapshot().get(nodes[random() % nodes.size()], position);
      const Vector3 centre =
          q % 3 == 0 || !p->allFinite() ? Vector3(origins[q % 4] + Vector3(u(random) * 200, 100, 1)) : *p;
      check(centre, q % 5 == 0 ? 0.0 : 1 + u(random) * 60, random() % 40);
      if (HasFatalFailure()) return;
    }
  }
  Transaction tx = db->begin();
  for (const NodeId n : nodes) ASSERT_TRUE(tx.remove(n));
  ASSERT_TRUE(tx.commit());
  check(origins[1], 1e9, 5);
}

TEST_F(GraphSpace, ACrowdOnOneSpotIsNoTrouble) {
  Transaction tx = db->begin();
  std::vector<NodeId> nodes;
  for (int i = 0; i < 5000; ++i) nodes.push_back(*tx.create(type));
  ASSERT_TRUE(tx.commit());
  for (int i = 0; i < 200; ++i) {
    Transaction step = db->begin();
    ASSERT_TRUE(step.set(nodes[static_cast<std::size_t>(i)], position, Vector3(i, 0, 0)));
    ASSERT_TRUE(step.commit());
  }
  check(Vector3(0, 0, 0), 0, 3);
  check(Vector3(100, 0, 0), 10.5, 30);
  EXPECT_EQ(db->snapshot().nearest(type, Vector3(0, 0, 0), 10).front(), nodes[0]);
}

}  // namespace
}  // namespace rigor::world
