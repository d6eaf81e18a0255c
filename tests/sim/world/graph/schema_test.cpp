#include <gtest/gtest.h>

#include <limits>

#include "sim/world/graph/database.h"
#include "sim/world/semantic_types.h"

namespace rigor::world {
namespace {

std::string text(const auto& r) { return r ? "accepted" : r.error().text(); }

TEST(GraphSchema, TellsOfTypesAttributesAndEdges) {
  const auto db = Database::create();
  ASSERT_TRUE(define_semantic_types(*db));
  const Schema& s = db->schema();
  const types::Body body(s);
  const types::Frame frame(s);
  EXPECT_TRUE(s.is_a(body.type, frame.type));
  EXPECT_TRUE(s.is_a(body.type, TypeId{0}));
  EXPECT_FALSE(s.is_a(frame.type, body.type));
  EXPECT_EQ(s.base(body.type), frame.type);
  EXPECT_EQ(s.attribute(s.attributes(body.type).front()).spec.name, "name") << "inherited ones first";
  EXPECT_EQ(s.attribute(frame.motion.id).spec.transient, true);
  EXPECT_EQ(s.attribute(body.size_m.id).kind(), ValueKind::vector3);
  EXPECT_EQ(s.edge(body.part_of).targets_per_source, Cardinality::one);
  EXPECT_EQ(text(s.attribute<double>("Tree", "dhb_m")),
            "Tree.dhb_m: no such attribute; did you mean 'dbh_m'?");
  EXPECT_EQ(text(s.attribute<double>("Tree", "species")),
            "Tree.species: expected an attribute of kind number, it is of kind text");
  EXPECT_THROW((void)s.require<double>("Treee", "x"), std::logic_error);
}

TEST(GraphSchema, RefusesWhatMakesNoSense) {
  const auto db = Database::create();
  ASSERT_TRUE(db->define(TypeSpec{.name = "A", .attributes = {{.name = "x", .default_value = 1.0}}}));
  EXPECT_FALSE(db->define(TypeSpec{.name = "A"}));
  EXPECT_FALSE(db->define(TypeSpec{.name = "a"}));
  EXPECT_FALSE(db->define(TypeSpec{.name = ""}));
  EXPECT_FALSE(db->define(TypeSpec{.name = "B", .base = "C"}));
  EXPECT_EQ(text(db->define(
                TypeSpec{.name = "B", .base = "A", .attributes = {{.name = "x", .default_value = 1.0}}})),
            "B.x: hides an inherited attribute");
  EXPECT_FALSE(db->define(
      TypeSpec{.name = "B",
               .attributes = {{.name = "x", .default_value = 1.0}, {.name = "x", .default_value = 1.0}}}));
  EXPECT_FALSE(
      db->define(TypeSpec{.name = "B", .attributes = {{.name = "x", .default_value = 5.0, .max = 4}}}));
  EXPECT_FALSE(db->define(
      TypeSpec{.name = "B",
               .attributes = {{.name = "x", .default_value = std::numeric_limits<double>::quiet_NaN()}}}));
  EXPECT_FALSE(db->define(
      TypeSpec{.name = "B", .attributes = {{.name = "x", .default_value = 1.0}}, .place_attribute = "x"}));
  EXPECT_FALSE(db->define(TypeSpec{.name = "B", .place_attribute = "y"}));
  EXPECT_FALSE(db->define(EdgeSpec{.name = "to", .from = "Nobody"}));
  EXPECT_EQ(db->schema().type_count(), 2u) << "what was refused leaves no trace";
  EXPECT_TRUE(db->define(TypeSpec{.name = "B", .base = "A"}));
  EXPECT_FALSE(db->add_attribute(db->schema().require_type("A"), {.name = "x", .default_value = 1.0}));
}

TEST(GraphSchema, GrowsUnderNodesThatAreThere) {
  const auto db = Database::create();
  const TypeId a = *db->define(TypeSpec{.name = "A", .attributes = {{.name = "x", .default_value = 1.0}}});
  const TypeId b =
      *db->define(TypeSpec{.name = "B", .base = "A", .attributes = {{.name = "y", .default_value = 2.0}}});
  const auto x = db->schema().require<double>("A", "x"), y = db->schema().require<double>("B", "y");
  std::vector<NodeId> nodes;
  {
    Transaction tx = db->begin();
    for (int i = 0; i < 300; ++i) {
      nodes.push_back(*tx.create(i % 2 ? a : b));
      ASSERT_TRUE(tx.set(nodes.back(), x, static_cast<double>(i)));
      if (i % 2 == 0) {
        ASSERT_TRUE(tx.set(nodes.back(), y, static_cast<double>(-i)));
      }
    }
    EXPECT_FALSE(db->add_attribute(a, {.name = "z", .default_value = 0.0})) << "not within a transaction";
    ASSERT_TRUE(tx.commit());
  }
  const Snapshot before = db->snapshot();
  const AttributeId z = *db->add_attribute(a, {.name = "z", .default_value = std::string("new")});
  EXPECT_EQ(db->schema().attributes(b).size(), 3u);
  EXPECT_EQ(db->schema().attributes(b)[1], z) << "inherited ones first";
  const Snapshot after = db->snapshot();
  EXPECT_FALSE(before.get(nodes[0], z)) << "a snapshot has the schema of its moment";
  EXPECT_EQ(before.schema().attributes(b).size(), 2u);
  for (std::size_t i = 0; i < nodes.size(); ++i) {
    EXPECT_EQ(std::get<std::string>(*after.get(nodes[i], z)), "new");
    EXPECT_EQ(*after.get(nodes[i], x), static_cast<double>(i));
    if (i % 2 == 0) {
      EXPECT_EQ(*after.get(nodes[i], y), -static_cast<double>(i));
    }
  }
  Transaction tx = db->begin();
  ASSERT_TRUE(tx.set(nodes[0], z, std::string("set")));
  ASSERT_TRUE(tx.commit());
  ASSERT_TRUE(db->undo());
  ASSERT_TRUE(db->undo()) << "history from before the attribute";
  EXPECT_EQ(db->snapshot().node_count(), 0u);
  ASSERT_TRUE(db->redo());
  EXPECT_EQ(*db->snapshot().get(nodes[8], y), -8.0);
}

TEST(GraphSchema, AnEmptySnapshotIsAnEmptyWorld) {
  const Snapshot s;
  EXPECT_EQ(s.node_count(), 0u);
  EXPECT_FALSE(s.contains(NodeId{1}));
  EXPECT_TRUE(s.nodes(TypeId{0}).empty());
  EXPECT_TRUE(s.in_radius(TypeId{0}, Vector3::Zero(), 1e9).empty());
  EXPECT_TRUE(s.nodes(TypeId{99}).empty());
  EXPECT_TRUE(s.targets(NodeId{1}, EdgeTypeId{}).empty());
  EXPECT_EQ(s.schema().type_count(), 1u);
}

TEST(GraphValues, NaNEqualsNaNAndSignsOfZeroDiffer) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_TRUE(same_value(nan, -nan));
  EXPECT_FALSE(same_value(0.0, -0.0));
  EXPECT_TRUE(same_value(Vector3(nan, 1, 2), Vector3(nan, 1, 2)));
  EXPECT_FALSE(same_value(1.0, std::int64_t{1}));
  EXPECT_TRUE(same_value(Numbers{1, nan}, Numbers{1, nan}));
}

TEST(GraphPoses, AreFunctionsOfTimeUpThePartOfEdges) {
  const auto db = Database::create();
  ASSERT_TRUE(define_semantic_types(*db));
  const types::Frame frame(db->schema());
  const types::Tree tree(db->schema());
  Transaction tx = db->begin();
  const NodeId robot = *tx.create(frame.type), arm = *tx.create(frame.type), oak = *tx.create(tree.type);
  ASSERT_TRUE(tx.set(robot, frame.pose, Pose(Eigen::Translation3d(100, 0, 0))));
  Motion m{.t_ref = BenchTime(1'000'000'000),
           .T_parent_node = Pose(Eigen::Translation3d(10, 0, 0)),
           .velocity_m_per_s = Vector3(0, 2, 0),
           .angular_velocity_rad_per_s = Vector3(0, 0, M_PI / 2)};
  ASSERT_TRUE(tx.set(robot, frame.motion, m));
  ASSERT_TRUE(tx.set(arm, frame.pose, Pose(Eigen::Translation3d(1, 0, 0))));
  ASSERT_TRUE(tx.connect(arm, frame.part_of, robot));
  ASSERT_TRUE(tx.set(oak, tree.position, Vector3(1, 2, 3)));
  ASSERT_TRUE(tx.commit());
  const BenchTime t(2'000'000'000);
  EXPECT_TRUE(db->snapshot().T_world_node(arm, t).translation().isApprox(Vector3(101, 0, 0)))
      << "it does not move";
  Transaction go = db->begin();
  ASSERT_TRUE(go.set(robot, frame.moves, true));
  ASSERT_TRUE(go.commit());
  const Snapshot s = db->snapshot();
  EXPECT_TRUE(s.T_world_node(robot, m.t_ref).isApprox(m.T_parent_node));
  EXPECT_TRUE(s.T_world_node(arm, t).translation().isApprox(Vector3(10, 3, 0), 1e-12));
  EXPECT_TRUE((s.T_world_node(arm, t).linear() * Vector3::UnitX()).isApprox(Vector3::UnitY(), 1e-12));
  EXPECT_TRUE(s.T_world_node(oak, t).translation().isApprox(Vector3(1, 2, 3)));
  EXPECT_TRUE(s.T_world_node(NodeId{77}, t).isApprox(Pose::Identity()));
}

TEST(GraphQueries, FollowPathsAndFindByNameAndValue) {
  const auto db = Database::create();
  ASSERT_TRUE(define_semantic_types(*db));
  const types::Object object(db->schema());
  const types::Body body(db->schema());
  const types::Material material(db->schema());
  Transaction tx = db->begin();
  const NodeId wood = *tx.create(material.type), cart = *tx.create(body.type);
  ASSERT_TRUE(tx.set(wood, material.name, std::string("wood")));
  std::vector<NodeId> planks;
  for (int i = 0; i < 100; ++i) {
    planks.push_back(*tx.create(body.type));
    ASSERT_TRUE(tx.connect(planks.back(), body.part_of, cart));
    ASSERT_TRUE(tx.connect(planks.back(), body.made_of, wood));
  }
  EXPECT_EQ(tx.connect(cart, body.part_of, planks[0]).error().text(),
            "Body#2 part_of Body#3: this would close a ring, and part_of allows none");
  EXPECT_EQ(tx.connect(planks[0], body.made_of, cart).error().text(),
            "Body#3 made_of Body#2: expected a target of type Material");
  EXPECT_EQ(
      tx.connect(planks[0], body.part_of, planks[1]).error().text(),
      "Body#3 part_of Body#4: the source may have one target only and has Body#2: disconnect that first");
  ASSERT_TRUE(tx.connect(planks[0], body.made_of, wood)) << "it is already: nothing to do";
  ASSERT_TRUE(tx.set(planks[40], body.shape, std::string("cylinder")));
  ASSERT_TRUE(tx.commit());
  const Snapshot s = db->snapshot();
  const Snapshot::Step down{body.part_of, true}, made{body.made_of, false};
  EXPECT_EQ(s.follow(cart, std::vector{down}), planks);
  EXPECT_EQ(s.follow(cart, std::vector{down, made}), std::vector<NodeId>{wood}) << "each once";
  EXPECT_EQ(s.follow(cart, {}), std::vector<NodeId>{cart});
  EXPECT_EQ(s.find_named(object.type, "wood"), wood);
  EXPECT_FALSE(s.find_named(body.type, "wood"));
  EXPECT_EQ(s.find_equal(body.type, body.shape.id, std::string("cylinder")), std::vector<NodeId>{planks[40]});
  EXPECT_EQ(s.sources(wood, body.made_of).size(), 100u);
  Transaction tx2 = db->begin();
  ASSERT_TRUE(tx2.remove(cart));
  ASSERT_TRUE(tx2.commit());
  EXPECT_EQ(db->snapshot().node_count(), 1u);
}

}  // namespace
}  // namespace rigor::world
