#include <gtest/gtest.h>

#include "sim/world/graph/database.h"

namespace rigor::world {
namespace {

class GraphSignals : public testing::Test {
 protected:
  GraphSignals() {
    base = *db->define(
        TypeSpec{.name = "Base", .abstract = true, .attributes = {{.name = "v", .default_value = 0.0}}});
    left = *db->define(
        TypeSpec{.name = "Left", .base = "Base", .attributes = {{.name = "w", .default_value = 0.0}}});
    right = *db->define(TypeSpec{.name = "Right", .base = "Base"});
    near = *db->define(EdgeSpec{.name = "near"});
    part_of = *db->define(EdgeSpec{.name = "part_of", .acyclic = true, .removes_sources = true});
    v = db->schema().require<double>("Base", "v");
    w = db->schema().require<double>("Left", "w");
  }
  NodeId make(TypeId t) {
    Transaction tx = db->begin("make");
    const NodeId n = *tx.create(t);
    EXPECT_TRUE(tx.commit());
    return n;
  }
  void set(NodeId n, double value) {
    Transaction tx = db->begin("set");
    EXPECT_TRUE(tx.set(n, v, value));
    EXPECT_TRUE(tx.commit());
  }
  Subscriber note(std::string who) {
    return [this, who](const ChangeSet&, std::span<const Change> mine) {
      for (const Change& c : mine) {
        constexpr const char* kWords[] = {"created", "changed", "removed", "connected", "disconnected"};
        heard.push_back(who + " " + kWords[static_cast<int>(c.kind)] + " " + std::to_string(c.node.value));
      }
    };
  }
  std::vector<std::string> take() { return std::exchange(heard, {}); }
  using Words = std::vector<std::string>;
  std::unique_ptr<Database> db = Database::create();
  TypeId base, left, right;
  EdgeTypeId near, part_of;
  Attribute<double> v, w;
  std::vector<std::string> heard;
};

TEST_F(GraphSignals, EachFilterHearsItsOwnAlone) {
  const NodeId a = make(left), b = make(right);
  const auto s1 = db->subscribe({.type = base}, note("base"));
  const auto s2 = db->subscribe({.type = left}, note("left"));
  const auto s3 = db->subscribe({.node = b}, note("b"));
  const auto s4 = db->subscribe({.type = left, .attribute = v.id}, note("left.v"));
  const auto s5 = db->subscribe({.attribute = w.id}, note("w"));
  const auto s6 = db->subscribe({.edge = near}, note("near"));
  set(a, 1);
  EXPECT_EQ(take(), (Words{"base changed 1", "left changed 1", "left.v changed 1"}));
  set(b, 1);
  EXPECT_EQ(take(), (Words{"base changed 2", "b changed 2"}));
  Transaction tx = db->begin();
  ASSERT_TRUE(tx.connect(a, near, b));
  ASSERT_TRUE(tx.set(a, w, 4.0));
  ASSERT_TRUE(tx.set(b, v, 2.0));
  ASSERT_TRUE(tx.set(a, w, 5.0));
  ASSERT_TRUE(tx.commit());
  EXPECT_EQ(take(), (Words{"base connected 1", "base changed 1", "base changed 2", "left connected 1",
                           "left changed 1", "b changed 2", "w changed 1", "near connected 1"}))
      << "each subscriber once, in the order of subscription; changes in the order of first touch";
}

TEST_F(GraphSignals, WhatCancelsOutIsNotTold) {
  const NodeId a = make(left), b = make(left);
  int calls = 0;
  const auto s = db->subscribe({}, [&](const ChangeSet&, std::span<const Change>) { ++calls; });
  Transaction tx = db->begin();
  ASSERT_TRUE(tx.set(a, v, 3.0));
  ASSERT_TRUE(tx.set(a, v, 0.0));
  ASSERT_TRUE(tx.connect(a, near, b));
  ASSERT_TRUE(tx.disconnect(a, near, b));
  const NodeId c = *tx.create(left);
  ASSERT_TRUE(tx.connect(c, near, a));
  ASSERT_TRUE(tx.set_dynamic(a, "x", 1.0));
  ASSERT_TRUE(tx.erase_dynamic(a, "x"));
  ASSERT_TRUE(tx.remove(c));
  ASSERT_TRUE(tx.commit());
  EXPECT_EQ(calls, 0);
}

TEST_F(GraphSignals, ARemovedNodeTakesPartsAndEdgesAlongAndIsReadFromBefore) {
  const NodeId whole = make(left), other = make(right);
  Transaction tx = db->begin();
  const NodeId part = *tx.create(left);
  ASSERT_TRUE(tx.set(part, v, 7.0));
  ASSERT_TRUE(tx.connect(part, part_of, whole));
  ASSERT_TRUE(tx.connect(other, near, part));
  ASSERT_TRUE(tx.commit());
  double last = 0;
  const auto s = db->subscribe({.type = base}, note("base"));
  Subscription r = db->subscribe({.node = part}, [&](const ChangeSet& set, std::span<const Change> mine) {
    EXPECT_FALSE(set.after.contains(part));
    for (const Change& c : mine)
      if (c.kind == ChangeKind::removed) last = *set.before.get(c.node, v);
  });
  Transaction tx2 = db->begin();
  ASSERT_TRUE(tx2.remove(whole));
  ASSERT_TRUE(tx2.commit());
  EXPECT_EQ(take(),
            (Words{"base disconnected 2", "base disconnected 3", "base removed 3", "base removed 1"}));
  EXPECT_EQ(last, 7.0);
  r.end();
  ASSERT_TRUE(db->undo());
  EXPECT_EQ(take(), (Words{"base created 1", "base created 3", "base connected 3", "base connected 2"}));
  EXPECT_EQ(*db->snapshot().get(part, v), 7.0);
  EXPECT_EQ(db->snapshot().target(part, part_of), whole);
}

TEST_F(GraphSignals, MayUnsubscribeThemselvesAndOthersFromWithin) {
  const NodeId a = make(left);
  Subscription first, second, third;
  int calls[4] = {};
  first = db->subscribe({}, [&](const ChangeSet&, std::span<const Change>) {
    ++calls[0];
    third.end();
  });
  second = db->subscribe({.node = a}, [&](const ChangeSet&, std::span<const Change>) {
    ++calls[1];
    second.end();  // destroys what runs
    ++calls[1];
  });
  third = db->subscribe({.type = left}, [&](const ChangeSet&, std::span<const Change>) { ++calls[2]; });
  set(a, 1);
  EXPECT_EQ(calls[0], 1);
  EXPECT_EQ(calls[1], 2);
  EXPECT_EQ(calls[2], 0) << "ended before it was its turn";
  std::vector<Subscription> late;
  first = db->subscribe({}, [&](const ChangeSet&, std::span<const Change>) {
    late.push_back(db->subscribe({}, [&](const ChangeSet&, std::span<const Change>) { ++calls[3]; }));
  });
  set(a, 2);
  EXPECT_EQ(calls[3], 0) << "what is subscribed now hears of the next";
  first.end();
  set(a, 3);
  EXPECT_EQ(calls[3], 1);
  EXPECT_EQ(calls[1], 2);
}

TEST_F(GraphSignals, PostsAreTransactionsOfTheirOwnAfterAllWereTold) {
  const NodeId a = make(left);
  std::vector<std::string> order;
  const auto s1 = db->subscribe({.attribute = v.id}, [&](const ChangeSet& set, std::span<const Change>) {
    order.push_back("one " + set.label);
    EXPECT_FALSE(db->begin().commit()) << "no transaction while others are told";
    EXPECT_FALSE(db->undo());
    if (*set.after.get(a, v) < 3)
      db->post("up", [&](Transaction& tx) { return tx.set(a, v, *tx.get(a, v) + 1); });
  });
  const auto s2 = db->subscribe({.attribute = v.id}, [&](const ChangeSet& set, std::span<const Change>) {
    order.push_back("two " + set.label);
  });
  set(a, 1);
  EXPECT_EQ(order, (Words{"one set", "two set", "one up", "two up", "one up", "two up"}));
  EXPECT_EQ(db->undo_labels(), (Words{"make", "set", "up", "up"}));
}

TEST_F(GraphSignals, AFailedPostIsRolledBackAndReported) {
  const NodeId a = make(left);
  std::vector<std::string> errors;
  db->on_post_error([&](const Error& e) { errors.push_back(e.text()); });
  db->post("bad", [&](Transaction& tx) -> Status {
    EXPECT_TRUE(tx.set(a, v, 9.0));
    return fail(ErrorCode::bad_input, "here", "no");
  });
  EXPECT_EQ(errors, Words{"here: no"});
  EXPECT_EQ(*db->snapshot().get(a, v), 0.0);
  db->post("good", [&](Transaction& tx) { return tx.set(a, v, 2.0); });
  EXPECT_EQ(*db->snapshot().get(a, v), 2.0);
}

TEST_F(GraphSignals, PostsWithoutEndAreStopped) {
  const NodeId a = make(left);
  std::vector<std::string> errors;
  db->on_post_error([&](const Error& e) { errors.push_back(e.text()); });
  const auto s = db->subscribe({.node = a}, [&](const ChangeSet&, std::span<const Change>) {
    db->post("again", [&](Transaction& tx) { return tx.set(a, v, *tx.get(a, v) + 1); });
  });
  set(a, 1);
  ASSERT_EQ(errors.size(), 1u);
  EXPECT_NE(errors[0].find("without end"), std::string::npos);
  EXPECT_EQ(*db->snapshot().get(a, v), 1001.0);
}

TEST_F(GraphSignals, SubscriptionsMayOutliveTheDatabase) {
  Subscription s = db->subscribe({}, note("late"));
  const NodeId a = make(left);
  const Snapshot kept = db->snapshot();
  db.reset();
  s.end();
  EXPECT_TRUE(kept.contains(a)) << "so may snapshots";
  EXPECT_EQ(kept.schema().type(left).name, "Left");
}

}  // namespace
}  // namespace rigor::world
