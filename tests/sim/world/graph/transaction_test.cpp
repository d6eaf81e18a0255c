#include <gtest/gtest.h>

#include <limits>

#include "sim/world/graph/database.h"
#include "sim/world/semantic_types.h"

namespace rigor::world {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

class GraphTransaction : public testing::Test {
 protected:
  GraphTransaction() { EXPECT_TRUE(define_semantic_types(*db)); }
  std::unique_ptr<Database> db = Database::create();
};

TEST_F(GraphTransaction, MakesANodeThatASnapshotShows) {
  const types::Tree tree(db->schema());
  Transaction tx = db->begin("plant");
  const NodeId oak = *tx.create(tree.type);
  ASSERT_TRUE(tx.set(oak, tree.species, std::string("QURO")));
  ASSERT_TRUE(tx.set(oak, tree.position, Vector3(1, 2, 3)));
  EXPECT_EQ(*tx.get(oak, tree.species), "QURO");
  const Snapshot before = db->snapshot();
  EXPECT_FALSE(before.contains(oak)) << "not committed yet";
  ASSERT_TRUE(tx.commit());
  const Snapshot s = db->snapshot();
  EXPECT_EQ(s.node_count(), 1u);
  EXPECT_EQ(*s.get(oak, tree.species), "QURO");
  EXPECT_EQ(*s.get(oak, tree.dbh_m), 0.3) << "the default";
  EXPECT_EQ(s.count(s.schema().require_type("Object")), 1u);
  EXPECT_EQ(s.in_radius(tree.type, Vector3(1, 2, 0), 3.0), std::vector<NodeId>{oak});
  EXPECT_TRUE(s.in_radius(tree.type, Vector3(1, 2, 0), 2.9).empty());
  EXPECT_FALSE(before.contains(oak)) << "a snapshot never changes";
}

TEST_F(GraphTransaction, RollsBackWhatWasNotCommitted) {
  const types::Tree tree(db->schema());
  NodeId a;
  {
    Transaction tx = db->begin();
    a = *tx.create(tree.type);
    ASSERT_TRUE(tx.set(a, tree.dbh_m, 1.0));
    ASSERT_TRUE(tx.commit());
  }
  {
    Transaction tx = db->begin();
    const NodeId b = *tx.create(tree.type);
    ASSERT_TRUE(tx.set(a, tree.dbh_m, 2.0));
    ASSERT_TRUE(tx.connect(b, tree.part_of, a));
    ASSERT_TRUE(tx.remove(a));
    EXPECT_FALSE(tx.view().contains(b)) << "part_of takes the part along";
  }
  const Snapshot s = db->snapshot();
  EXPECT_EQ(s.node_count(), 1u);
  EXPECT_EQ(*s.get(a, tree.dbh_m), 1.0);
  EXPECT_TRUE(s.sources(a, tree.part_of).empty());
  EXPECT_EQ(db->statistics().rollbacks, 1u);
}

TEST_F(GraphTransaction, RefusesAWrongWriteAndStaysOpen) {
  const types::Tree tree(db->schema());
  const types::Atmosphere air(db->schema());
  Transaction tx = db->begin();
  const NodeId a = *tx.create(tree.type);
  const auto message = [](const Status& s) { return s ? std::string("accepted") : s.error().text(); };
  EXPECT_EQ(message(tx.set(a, tree.dbh_m, 13.0)), "Tree#1.dbh_m: expected 0 to 12 m, got 13");
  EXPECT_EQ(message(tx.set(a, tree.dbh_m, kNaN)), "Tree#1.dbh_m: expected a number, got NaN");
  EXPECT_EQ(message(tx.set(a, air.turbidity, 3.0)),
            "Tree#1.turbidity: the attribute belongs to another type, Atmosphere");
  EXPECT_EQ(
      message(tx.set(a, "dbh", 1.0)),
      "Tree#1.dbh: no such attribute; did you mean 'dbh_m'? (set_dynamic makes one of this node alone)");
  EXPECT_EQ(message(tx.set(a, "dbh_m", std::int64_t{1})),
            "Tree#1.dbh_m: expected a value of kind number, got one of kind integer");
  EXPECT_EQ(message(tx.set(NodeId{99}, tree.dbh_m, 1.0)), "node#99.dbh_m: there is no such node");
  const auto made = tx.create("Tre");
  EXPECT_EQ(made.error().text(), "Tre: no such node type; did you mean 'Tree'?");
  ASSERT_TRUE(tx.set(a, tree.position, Vector3(0, 0, kNaN))) << "NaN means: on the terrain";
  ASSERT_TRUE(tx.commit());
  EXPECT_EQ(db->snapshot().node_count(), 1u);
}

TEST_F(GraphTransaction, IsToldOnceInOrderAndPostsRunAfter) {
  const types::Tree tree(db->schema());
  std::vector<std::string> heard;
  NodeId tree_id;
  const auto watch =
      db->subscribe({.type = tree.type}, [&](const ChangeSet& set, std::span<const Change> mine) {
        heard.push_back("tree " + std::to_string(mine.size()));
        if (set.label == "plant")
          db->post("grow", [&](Transaction& tx) { return tx.set(tree_id, tree.height_m, 20.0); });
      });
  const auto all = db->subscribe(
      {}, [&](const ChangeSet& set, std::span<const Change>) { heard.push_back("all " + set.label); });
  Transaction tx = db->begin("plant");
  tree_id = *tx.create(tree.type);
  ASSERT_TRUE(tx.set(tree_id, tree.height_m, 10.0));
  ASSERT_TRUE(tx.commit());
  EXPECT_EQ(heard, (std::vector<std::string>{"tree 1", "all plant", "tree 1", "all grow"}));
  EXPECT_EQ(*db->snapshot().get(tree_id, tree.height_m), 20.0);
}

}  // namespace
}  // namespace rigor::world
