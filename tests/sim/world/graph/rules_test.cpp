#include <gtest/gtest.h>

#include "sim/world/graph/database.h"

namespace rigor::world {
namespace {

class GraphRules : public testing::Test {
 protected:
  GraphRules() {
    item = *db->define(TypeSpec{.name = "Item",
                                .attributes = {{.name = "a", .default_value = 0.0},
                                               {.name = "b", .default_value = 0.0},
                                               {.name = "c", .default_value = 0.0}}});
    box = *db->define(TypeSpec{.name = "Box", .attributes = {{.name = "sum", .default_value = 0.0}}});
    in = *db->define(EdgeSpec{.name = "in", .from = "Item", .to = "Box"});
    a = db->schema().require<double>("Item", "a");
    b = db->schema().require<double>("Item", "b");
    c = db->schema().require<double>("Item", "c");
    sum = db->schema().require<double>("Box", "sum");
  }
  /// to = from + 1, for new items and changed ones.
  Rule successor(std::string name, Attribute<double> from, Attribute<double> to) {
    return {.name = std::move(name),
            .when = {.type = item},
            .writes = {to.id},
            .run = [this, from, to](Transaction& tx, std::span<const Change> mine) -> Status {
              ++runs;
              for (const Change& ch : mine)
                if (auto s = tx.set(ch.node, to, *tx.get(ch.node, from) + 1); !s) return s;
              return {};
            },
            .reads = {from.id}};
  }
  static std::string text(const Status& s) { return s ? "accepted" : s.error().text(); }
  std::unique_ptr<Database> db = Database::create();
  TypeId item, box;
  EdgeTypeId in;
  Attribute<double> a, b, c, sum;
  int runs = 0;
};

TEST_F(GraphRules, FeedEachOtherWhateverTheOrderOfTheirAdding) {
  ASSERT_TRUE(db->add_rule(successor("second", b, c)));
  ASSERT_TRUE(db->add_rule(successor("first", a, b)));
  std::vector<std::size_t> told;
  const auto watch = db->subscribe(
      {}, [&](const ChangeSet& set, std::span<const Change>) { told.push_back(set.changes.size()); });
  Transaction tx = db->begin("one");
  const NodeId n = *tx.create(item);
  ASSERT_TRUE(tx.set(n, a, 5.0));
  ASSERT_TRUE(tx.commit());
  EXPECT_EQ(*db->snapshot().get(n, b), 6.0);
  EXPECT_EQ(*db->snapshot().get(n, c), 7.0);
  Transaction tx2 = db->begin("two");
  ASSERT_TRUE(tx2.set(n, a, 10.0));
  ASSERT_TRUE(tx2.commit());
  EXPECT_EQ(*db->snapshot().get(n, c), 12.0);
  EXPECT_EQ(told, (std::vector<std::size_t>{1, 3})) << "created; then a, b and c at once";
  ASSERT_TRUE(db->undo()) << "one step, with what the rules wrote";
  EXPECT_EQ(*db->snapshot().get(n, a), 5.0);
  EXPECT_EQ(*db->snapshot().get(n, b), 6.0);
  EXPECT_EQ(*db->snapshot().get(n, c), 7.0);
  ASSERT_TRUE(db->redo());
  EXPECT_EQ(*db->snapshot().get(n, c), 12.0);
  EXPECT_EQ(runs, 4) << "each once a transaction, and not for undo and redo";
}

TEST_F(GraphRules, ARingIsRefusedAndNamed) {
  ASSERT_TRUE(db->add_rule(successor("ab", a, b)));
  ASSERT_TRUE(db->add_rule(successor("bc", b, c)));
  EXPECT_EQ(
      text(db->add_rule(successor("ca", c, a))),
      "ca: the rules form a ring, each writing what the next reads: ca -> ab -> bc -> ca (a filter that "
      "names an attribute hears less)");
  EXPECT_EQ(text(db->add_rule(successor("aa", a, a))),
            "aa: the rule writes what it reads: it would call on itself");
  EXPECT_EQ(text(db->add_rule(successor("ab", a, c))), "ab: a rule of this name is there already");
  EXPECT_EQ(text(db->add_rule(successor("", a, c))), "rule: a rule needs a name");
  Transaction tx = db->begin();
  const NodeId n = *tx.create(item);
  ASSERT_TRUE(tx.set(n, a, 1.0));
  ASSERT_TRUE(tx.commit()) << "what was refused leaves no trace";
  EXPECT_EQ(*db->snapshot().get(n, c), 3.0);
}

TEST_F(GraphRules, AVetoRollsBackEverything) {
  ASSERT_TRUE(db->add_rule(successor("ab", a, b)));
  bool posted = false;
  ASSERT_TRUE(db->add_rule({.name = "at most three",
                            .when = {.attribute = b.id},
                            .run = [&](Transaction& tx, std::span<const Change> mine) -> Status {
                              db->post("from a rule", [&](Transaction&) -> Status {
                                posted = true;
                                return {};
                              });
                              for (const Change& ch : mine)
                                if (*tx.get(ch.node, b) > 3)
                                  return fail(ErrorCode::bad_input, "", "b is above three");
                              return {};
                            }}));
  int told = 0;
  const auto watch = db->subscribe({}, [&](const ChangeSet&, std::span<const Change>) { ++told; });
  Transaction tx = db->begin();
  const NodeId n = *tx.create(item);
  ASSERT_TRUE(tx.commit());
  EXPECT_EQ(told, 1);
  const Snapshot before = db->snapshot();
  Transaction bad = db->begin("grow");
  ASSERT_TRUE(bad.set(n, a, 5.0));
  const NodeId m = *bad.create(item);
  const NodeId crate = *bad.create(box);
  ASSERT_TRUE(bad.connect(n, in, crate));
  EXPECT_EQ(text(bad.commit()), "grow: rule 'at most three' refuses the transaction: b is above three");
  const Snapshot s = db->snapshot();
  EXPECT_EQ(s.revision(), before.revision());
  EXPECT_EQ(*s.get(n, a), 0.0);
  EXPECT_EQ(*s.get(n, b), 1.0);
  EXPECT_FALSE(s.contains(m));
  EXPECT_TRUE(s.targets(n, in).empty());
  EXPECT_EQ(told, 1);
  EXPECT_FALSE(posted) << "a post of a rule goes with its transaction";
  EXPECT_EQ(db->undo_labels().size(), 1u);
  Transaction good = db->begin();
  ASSERT_TRUE(good.set(n, a, 1.0)) << "the database goes on";
  ASSERT_TRUE(good.commit());
  EXPECT_TRUE(posted);
}

TEST_F(GraphRules, AValueThatGoesToAndFroEndsWithAnError) {
  ASSERT_TRUE(db->add_rule({.name = "flip",
                            .when = {.type = item},
                            .writes = {a.id},
                            .run = [&](Transaction& tx, std::span<const Change> mine) -> Status {
                              return tx.set(mine[0].node, a, 1 - *tx.get(mine[0].node, a));
                            }}));
  Transaction tx = db->begin("start");
  const NodeId n = *tx.create(item);
  EXPECT_EQ(text(tx.commit()),
            "start: rule 'flip' finds no fixpoint: after 100 rounds it still changes what it hears of");
  EXPECT_FALSE(db->snapshot().contains(n));
}

TEST_F(GraphRules, ARuleThatHearsItsOwnWritesMayComeToRest) {
  ASSERT_TRUE(db->add_rule({.name = "count to five",
                            .when = {.type = item},
                            .writes = {a.id},
                            .run = [&](Transaction& tx, std::span<const Change> mine) -> Status {
                              const double v = *tx.get(mine[0].node, a);
                              return v < 5 ? tx.set(mine[0].node, a, v + 1) : Status();
                            }}));
  Transaction tx = db->begin();
  const NodeId n = *tx.create(item);
  ASSERT_TRUE(tx.commit());
  EXPECT_EQ(*db->snapshot().get(n, a), 5.0);
}

TEST_F(GraphRules, AWriteThatIsNotDeclaredIsRefused) {
  ASSERT_TRUE(db->add_rule({.name = "sly",
                            .when = {.attribute = a.id},
                            .writes = {b.id},
                            .run = [&](Transaction& tx, std::span<const Change> mine) -> Status {
                              EXPECT_FALSE(tx.create(box));
                              EXPECT_FALSE(tx.remove(mine[0].node));
                              EXPECT_FALSE(tx.commit());
                              return tx.set(mine[0].node, c, 1.0);
                            }}));
  Transaction tx = db->begin();
  const NodeId n = *tx.create(item);
  ASSERT_TRUE(tx.commit());
  Transaction bad = db->begin("t");
  ASSERT_TRUE(bad.set(n, a, 1.0));
  EXPECT_EQ(
      text(bad.commit()),
      "t: rule 'sly' refuses the transaction: sly: the rule writes c, which its `writes` does not name");
}

TEST_F(GraphRules, KeepASumOverEdges) {
  ASSERT_TRUE(db->add_rule({.name = "sum",
                            .when = {.edge = in},
                            .writes = {sum.id},
                            .run = [&](Transaction& tx, std::span<const Change> mine) -> Status {
                              const Snapshot now = tx.view();
                              for (const Change& ch : mine) {
                                if (!now.contains(ch.other)) continue;
                                double s = 0;
                                for (const NodeId n : now.sources(ch.other, in)) s += *now.get(n, a);
                                if (auto done = tx.set(ch.other, sum, s); !done) return done;
                              }
                              return {};
                            }}));
  Transaction tx = db->begin();
  const NodeId crate = *tx.create(box);
  NodeId last;
  for (int i = 1; i <= 4; ++i) {
    last = *tx.create(item);
    ASSERT_TRUE(tx.set(last, a, static_cast<double>(i)));
    ASSERT_TRUE(tx.connect(last, in, crate));
  }
  ASSERT_TRUE(tx.commit());
  EXPECT_EQ(*db->snapshot().get(crate, sum), 10.0);
  Transaction tx2 = db->begin();
  ASSERT_TRUE(tx2.remove(last));
  ASSERT_TRUE(tx2.commit());
  EXPECT_EQ(*db->snapshot().get(crate, sum), 6.0) << "removing a node cuts its edges, and says so";
  ASSERT_TRUE(db->undo());
  EXPECT_EQ(*db->snapshot().get(crate, sum), 10.0);
}

}  // namespace
}  // namespace rigor::world
