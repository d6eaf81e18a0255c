// Readers of snapshots while the world goes on; run under the thread sanitizer too.
#include <gtest/gtest.h>

#include <atomic>
#include <random>
#include <thread>

#include "sim/world/graph/database.h"

namespace rigor::world {
namespace {

struct Ledger {
  explicit Ledger(std::size_t n) {
    type = *db->define(TypeSpec{.name = "Account",
                                .attributes = {{.name = "position", .default_value = Vector3(0, 0, 0)},
                                               {.name = "money", .default_value = std::int64_t{0}},
                                               {.name = "word", .default_value = std::string()}},
                                .place_attribute = "position"});
    owes = *db->define(EdgeSpec{.name = "owes"});
    position = db->schema().require<Vector3>("Account", "position");
    money = db->schema().require<std::int64_t>("Account", "money");
    word = db->schema().require<std::string>("Account", "word");
    Transaction tx = db->begin();
    for (std::size_t i = 0; i < n; ++i) {
      nodes.push_back(*tx.create(type));
      EXPECT_TRUE(tx.set(nodes.back(), money, std::int64_t{100}));
      EXPECT_TRUE(tx.set(nodes.back(), position, Vector3(static_cast<double>(i), 0, 0)));
    }
    EXPECT_TRUE(tx.commit());
  }
  /// Money changes hands; its sum stays. Edges go both ways or not at all; a node's word is its place's.
  void trade(std::mt19937& random) {
    Transaction tx = db->begin();
    for (int i = 0; i < 5; ++i) {
      const NodeId a = nodes[random() % nodes.size()], b = nodes[random() % nodes.size()];
      const std::int64_t sum = 1 + static_cast<std::int64_t>(random() % 10);
      if (a == b) continue;
      EXPECT_TRUE(tx.set(a, money, *tx.get(a, money) - sum));
      EXPECT_TRUE(tx.set(b, money, *tx.get(b, money) + sum));
      if (random() % 2) {
        EXPECT_TRUE(tx.connect(a, owes, b));
        EXPECT_TRUE(tx.connect(b, owes, a));
      } else if (tx.disconnect(a, owes, b)) {
        EXPECT_TRUE(tx.disconnect(b, owes, a));
      }
      const auto x = static_cast<double>(random() % 1000);
      EXPECT_TRUE(tx.set(a, position, Vector3(x, 0, 0)));
      EXPECT_TRUE(tx.set(a, word, "a place with a long name " + std::to_string(static_cast<int>(x))));
    }
    if (random() % 4 == 0) {  // one goes, one comes, with what the other had
      const std::size_t i = random() % nodes.size();
      const std::int64_t left = *tx.get(nodes[i], money);
      EXPECT_TRUE(tx.remove(nodes[i]));
      nodes[i] = *tx.create(type);
      EXPECT_TRUE(tx.set(nodes[i], money, left));
    }
    EXPECT_TRUE(tx.commit());
  }
  /// Empty where all is as it must be.
  [[nodiscard]] std::string fault(const Snapshot& s) const {
    if (s.node_count() != nodes_count) return "nodes";
    std::int64_t sum = 0;
    s.scan(type, money, [&](std::span<const NodeId>, std::span<const std::int64_t> m) {
      for (const auto v : m) sum += v;
    });
    if (sum != 100 * static_cast<std::int64_t>(nodes_count)) return "sum";
    std::string wrong;
    s.for_each(type, [&](NodeId n) {
      for (const NodeId o : s.targets(n, owes)) {
        const auto back = s.targets(o, owes);
        if (std::find(back.begin(), back.end(), n) == back.end()) wrong = "edge";
      }
      const std::string& w = *s.get(n, word);
      if (!w.empty() && std::stod(w.substr(25)) != s.get(n, position)->x()) wrong = "word";
    });
    if (!wrong.empty()) return wrong;
    if (s.in_radius(type, Vector3(500, 0, 0), 1e6).size() != nodes_count) return "space";
    return "";
  }
  std::unique_ptr<Database> db = Database::create({.undo_steps = 20});
  TypeId type;
  EdgeTypeId owes;
  Attribute<Vector3> position;
  Attribute<std::int64_t> money;
  Attribute<std::string> word;
  std::vector<NodeId> nodes;
  std::size_t nodes_count = 0;
};

TEST(GraphSnapshot, IsReadByManyThreadsWhileTheWorldGoesOn) {
  Ledger ledger(300);
  ledger.nodes_count = 300;
  std::atomic<bool> stop{false};
  std::atomic<int> reads{0};
  std::vector<std::thread> readers;
  for (int i = 0; i < 3; ++i)
    readers.emplace_back([&, i] {
      std::vector<Snapshot> kept;
      std::uint64_t last = 0;
      while (!stop || reads < 30) {
        const Snapshot s = ledger.db->snapshot();
        EXPECT_GE(s.revision(), last) << "time does not run backwards";
        last = s.revision();
        EXPECT_EQ(ledger.fault(s), "");
        kept.push_back(s);
        if (kept.size() > static_cast<std::size_t>(2 + 3 * i)) {
          EXPECT_EQ(ledger.fault(kept.front()), "") << "an old one has not changed";
          kept.erase(kept.begin());
        }
        ++reads;
      }
    });
  std::mt19937 random(3);
  for (int i = 0; i < 1500; ++i) {
    ledger.trade(random);
    if (i % 100 == 50) {
      EXPECT_TRUE(ledger.db->undo());
      EXPECT_TRUE(ledger.db->redo());
    }
  }
  stop = true;
  for (auto& t : readers) t.join();
  EXPECT_GE(reads, 30);
  EXPECT_EQ(ledger.fault(ledger.db->snapshot()), "");
}

TEST(GraphSnapshot, OfATransactionIsOneThatAnotherThreadMayRead) {
  Ledger ledger(50);
  ledger.nodes_count = 50;
  Transaction tx = ledger.db->begin();
  for (int i = 0; i < 20; ++i) {
    ASSERT_TRUE(tx.set(ledger.nodes[0], ledger.money, std::int64_t{100 - i}));
    ASSERT_TRUE(tx.set(ledger.nodes[1], ledger.money, std::int64_t{100 + i}));
    std::thread([&, view = tx.view()] { EXPECT_EQ(ledger.fault(view), ""); }).join();
  }
  tx.rollback();
  EXPECT_EQ(*ledger.db->snapshot().get(ledger.nodes[0], ledger.money), 100);
}

TEST(GraphSnapshot, IsolatesAHundredThousandNodes) {
  Ledger ledger(100'000);
  ledger.nodes_count = 100'000;
  const Snapshot before = ledger.db->snapshot();
  const std::size_t held = ledger.db->statistics().bytes;
  for (int i = 0; i < 10; ++i) {
    Transaction tx = ledger.db->begin();
    ASSERT_TRUE(tx.set(ledger.nodes[77], ledger.money, std::int64_t{i}));
    ASSERT_TRUE(tx.commit());
    const Snapshot s = ledger.db->snapshot();
    EXPECT_EQ(*s.get(ledger.nodes[77], ledger.money), i);
  }
  EXPECT_LT(ledger.db->statistics().bytes, held + 20'000) << "what changed is kept twice, not the world";
  Transaction tx = ledger.db->begin();
  for (std::size_t i = 0; i < ledger.nodes.size(); i += 2) ASSERT_TRUE(tx.remove(ledger.nodes[i]));
  for (std::size_t i = 1; i < ledger.nodes.size(); i += 2)
    ASSERT_TRUE(tx.set(ledger.nodes[i], ledger.money, std::int64_t{1}));
  ASSERT_TRUE(tx.commit());
  EXPECT_EQ(ledger.db->snapshot().node_count(), 50'000u);
  EXPECT_EQ(before.node_count(), 100'000u);
  EXPECT_EQ(ledger.fault(before), "");
  for (std::size_t i = 0; i < ledger.nodes.size(); ++i)
    ASSERT_EQ(*before.get(ledger.nodes[i], ledger.money), 100);
}

TEST(GraphSnapshot, GivesItsRoomBack) {
  Ledger ledger(1000);
  ledger.nodes_count = 1000;
  std::mt19937 random(5);
  std::vector<Snapshot> kept;
  for (int i = 0; i < 200; ++i) {
    ledger.trade(random);
    kept.push_back(ledger.db->snapshot());
  }
  const std::size_t full = ledger.db->statistics().bytes;
  kept.clear();
  ledger.trade(random);
  EXPECT_LT(ledger.db->statistics().bytes, full / 3);
  // Out of order, and with one that stays.
  const Snapshot old = ledger.db->snapshot();
  const std::size_t before = ledger.db->statistics().bytes;
  for (int i = 0; i < 2000; ++i) {
    ledger.trade(random);
    kept.push_back(ledger.db->snapshot());
    if (kept.size() > 5) kept.erase(kept.begin() + static_cast<long>(random() % kept.size()));
  }
  kept.clear();
  ledger.trade(random);
  EXPECT_LT(ledger.db->statistics().bytes, 3 * before) << "what lies between two snapshots goes";
  EXPECT_EQ(ledger.fault(old), "");
}

}  // namespace
}  // namespace rigor::world
