// What a world file keeps, and that the sqlite3 shell can read it.
#include "sim/world/store/world_file.h"

#include <gtest/gtest.h>
#include <sqlite3.h>

#include <fstream>

#include "sim/world/semantic_types.h"
#include "tests/sim/world/store/test_world.h"

namespace rigor::world {
namespace {

using test::make_database;
using test::TemporaryFolder;

/// The first column of the first row, by a connection of its own.
std::string ask(const std::filesystem::path& file, const std::string& sql) {
  sqlite3* db = nullptr;
  EXPECT_EQ(sqlite3_open_v2(file.c_str(), &db, SQLITE_OPEN_READWRITE, nullptr), SQLITE_OK);
  std::string out;
  char* error = nullptr;
  sqlite3_exec(
      db, sql.c_str(),
      [](void* to, int n, char** values, char**) {
        auto& text = *static_cast<std::string*>(to);
        for (int i = 0; i < n; ++i)
          text += (text.empty() ? "" : "|") + std::string(values[i] ? values[i] : "NULL");
        return 0;
      },
      &out, &error);
  EXPECT_EQ(error, nullptr) << error << " in " << sql;
  sqlite3_free(error);
  sqlite3_close(db);
  return out;
}

std::unique_ptr<WorldFile> must(Result<std::unique_ptr<WorldFile>> file) {
  EXPECT_TRUE(file) << file.error().text();
  return file ? std::move(*file) : nullptr;
}

#define ASSERT_OK(status)                   \
  do {                                      \
    const auto ok_ = (status);              \
    ASSERT_TRUE(ok_) << ok_.error().text(); \
  } while (false)

std::string reopened(const std::filesystem::path& file, Database& db) {
  auto again = WorldFile::open(file, db);
  EXPECT_TRUE(again) << again.error().text();
  return world_yaml(db.snapshot());
}

TEST(WorldFile, GivesBackWhatEachPersistAcknowledged) {
  TemporaryFolder folder;
  const auto file = folder / "w.rigor";
  auto db = make_database();
  auto out = must(WorldFile::create(file, *db));
  for (std::uint64_t step = 0; step < 120; ++step) {
    test::change(*db, step);
    if (step % 3 == 0) continue;  // several transactions in one persist
    ASSERT_OK(out->persist());
    auto other = make_database();
    ASSERT_EQ(reopened(file, *other), world_yaml(db->snapshot())) << "step " << step;
  }
  EXPECT_GT(db->snapshot().node_count(), 12U);
}

TEST(WorldFile, BringsItsTypesToADatabaseThatHasNone) {
  TemporaryFolder folder;
  auto db = make_database();
  for (std::uint64_t step = 0; step < 40; ++step) test::change(*db, step);
  {
    auto out = must(WorldFile::create(folder / "w", *db));
    ASSERT_OK(out->persist());
  }
  auto bare = Database::create();
  EXPECT_EQ(reopened(folder / "w", *bare), world_yaml(db->snapshot()));
  EXPECT_TRUE(bare->schema().find_type("Select"));
  EXPECT_TRUE(bare->schema().type(*bare->schema().find_type("Idea")).abstract);
}

TEST(WorldFile, GoesOnAfterItWasOpened) {
  TemporaryFolder folder;
  const auto file = folder / "w";
  std::string last;
  for (std::uint64_t round = 0; round < 12; ++round) {
    auto db = make_database();
    auto f = must(round == 0 ? WorldFile::create(file, *db) : WorldFile::open(file, *db));
    EXPECT_EQ(round == 0 ? "" : world_yaml(db->snapshot()), last);
    for (std::uint64_t step = 0; step < 7; ++step) test::change(*db, round * 7 + step);
    ASSERT_OK(f->persist());
    last = world_yaml(db->snapshot());
  }
}

TEST(WorldFile, KeepsAWorldOfTheSemanticTypes) {
  TemporaryFolder folder;
  auto db = Database::create();
  ASSERT_OK(define_semantic_types(*db));
  const types::Tree tree(db->schema());
  {
    auto tx = db->begin();
    for (int i = 0; i < 100; ++i) {
      const auto node = *tx.create(tree.type);
      ASSERT_OK(tx.set(node, tree.position, Vector3(i, -i, std::nan(""))));
      ASSERT_OK(tx.set(node, tree.species, std::string(i % 2 ? "PSME" : "TSHE")));
      ASSERT_OK(tx.set(node, tree.height_m, 10.0 + i));
    }
    ASSERT_OK(tx.commit());
  }
  auto f = must(WorldFile::create(folder / "w", *db));
  ASSERT_OK(f->persist());
  EXPECT_EQ(ask(folder / "w",
                "SELECT species, count(*), max(height_m), avg(\"position.x\"), max(\"position.z\") "
                "FROM Tree GROUP BY species ORDER BY species"),
            "PSME|50|109.0|50.0|NULL|TSHE|50|108.0|49.0|NULL");
  auto other = Database::create();
  ASSERT_OK(define_semantic_types(*other));
  EXPECT_EQ(reopened(folder / "w", *other), world_yaml(db->snapshot()));
}

TEST(WorldFile, IsReadBySqlAndSaysWhatItIs) {
  TemporaryFolder folder;
  const auto file = folder / "w";
  auto db = make_database();
  const auto& s = db->schema();
  NodeId a, b;
  {
    auto tx = db->begin();
    a = *tx.create(s.require_type("SmallThing"));
    b = *tx.create(s.require_type("Nodes"));
    ASSERT_OK(tx.set(a, "a_text", Value(std::string("it's"))));
    ASSERT_OK(tx.set(a, "a_number", Value(-0.0)));
    ASSERT_OK(tx.set(a, "a_numbers", Value(Numbers{1.0})));
    ASSERT_OK(tx.set_dynamic(b, "seen", Value(std::int64_t{3})));
    ASSERT_OK(tx.connect(a, s.require_edge("likes"), b));
    ASSERT_OK(tx.commit());
  }
  auto f = must(WorldFile::create(file, *db));
  ASSERT_OK(f->persist());
  EXPECT_EQ(ask(file, "PRAGMA application_id"), std::to_string(0x52676F72));
  EXPECT_EQ(ask(file, "SELECT value FROM meta WHERE key = 'schema_version'"), "2");
  EXPECT_EQ(ask(file, "SELECT n.id, t.name FROM nodes n JOIN types t ON t.id = n.type ORDER BY n.id"),
            "1|SmallThing|2|Nodes");
  EXPECT_EQ(ask(file,
                "SELECT a_text, \"a_vector3.y\", \"a_pose.r11\", hex(a_number), hex(a_numbers), size_m "
                "FROM SmallThing"),
            "it's|2.0|1.0|0000000000000080|000000000000F03F|NULL");
  EXPECT_EQ(ask(file, "SELECT e.source, t.name, e.target FROM edges e JOIN edge_types t ON t.id = e.type"),
            "1|likes|2");
  EXPECT_EQ(ask(file, "SELECT node, name, kind, value FROM dynamic_attributes"), "2|seen|integer|3");
  // A type that bears the name of one of the file's own tables, and two that differ in capitals alone.
  EXPECT_EQ(ask(file, "SELECT count(DISTINCT lower(table_name)), sum(table_name = 'Thing') FROM types"),
            "7|1");
}

TEST(WorldFile, KeepsNothingTransient) {
  TemporaryFolder folder;
  const auto file = folder / "w";
  auto db = make_database();
  const auto& s = db->schema();
  auto f = must(WorldFile::create(file, *db));
  auto tx = db->begin();
  const auto node = *tx.create(s.require_type("Thing"));
  ASSERT_OK(tx.set(node, "t_text", Value(std::string("SECRETWORD"))));
  ASSERT_OK(tx.commit());
  ASSERT_OK(f->persist());
  const auto generation = ask(file, "SELECT value FROM meta WHERE key = 'generation'");
  auto moving = db->begin();
  ASSERT_OK(moving.set(node, "t_text", Value(std::string("SECRETWORD2"))));
  ASSERT_OK(moving.commit());
  ASSERT_OK(f->persist());
  EXPECT_EQ(ask(file, "SELECT value FROM meta WHERE key = 'generation'"), generation) << "nothing to write";
  EXPECT_EQ(ask(file, "SELECT count(*) FROM pragma_table_info('Thing') WHERE name LIKE 't\\_%' ESCAPE '\\'"),
            "0");
  std::ifstream in(file, std::ios::binary);
  const std::string bytes((std::istreambuf_iterator<char>(in)), {});
  EXPECT_EQ(bytes.find("SECRETWORD"), std::string::npos);
  auto other = make_database();
  reopened(file, *other);
  EXPECT_TRUE(same_value(*other->snapshot().get(node, "t_text"), Value(std::string("none"))));
}

TEST(WorldFile, NeverGivesAnIdTwice) {
  TemporaryFolder folder;
  const auto file = folder / "w";
  auto db = make_database();
  const auto type = db->schema().require_type("Thing");
  auto f = must(WorldFile::create(file, *db));
  NodeId last;
  {
    auto tx = db->begin();
    for (int i = 0; i < 5; ++i) last = *tx.create(type);
    ASSERT_OK(tx.commit());
  }
  ASSERT_OK(f->persist());
  {
    auto tx = db->begin();
    ASSERT_OK(tx.remove(last));
    ASSERT_OK(tx.commit());
  }
  ASSERT_OK(f->persist());
  f.reset();
  auto other = make_database();
  auto g = must(WorldFile::open(file, *other));
  EXPECT_FALSE(other->snapshot().contains(last));
  auto tx = other->begin();
  EXPECT_GT(*tx.create(type), last);
}

TEST(WorldFile, KeepsLargeIds) {
  TemporaryFolder folder;
  auto db = make_database();
  const auto type = db->schema().require_type("Thing");
  constexpr std::uint64_t kLast = (1ULL << 62) - 1;
  auto tx = db->begin();
  for (const std::uint64_t id : {std::uint64_t{1}, std::uint64_t{1} << 40, kLast})
    ASSERT_OK(tx.create_as(NodeId{id}, type));
  ASSERT_OK(tx.connect(NodeId{1}, db->schema().require_edge("likes"), NodeId{kLast}));
  ASSERT_OK(tx.commit());
  auto f = must(WorldFile::create(folder / "w", *db));
  ASSERT_OK(f->persist());
  auto other = make_database();
  EXPECT_EQ(reopened(folder / "w", *other), world_yaml(db->snapshot()));
}

TEST(WorldFile, KeepsTheOrderOfTargets) {
  TemporaryFolder folder;
  auto db = make_database();
  const auto& s = db->schema();
  const auto likes = s.require_edge("likes");
  std::vector<NodeId> n;
  auto f = must(WorldFile::create(folder / "w", *db));
  auto tx = db->begin();
  for (int i = 0; i < 5; ++i) n.push_back(*tx.create(s.require_type("Object")));
  for (const int i : {4, 2, 0, 3}) ASSERT_OK(tx.connect(n[1], likes, n[static_cast<std::size_t>(i)]));
  ASSERT_OK(tx.commit());
  ASSERT_OK(f->persist());
  for (const bool on : {false, true}) {
    auto again = db->begin();
    ASSERT_OK(on ? again.connect(n[1], likes, n[4]) : again.disconnect(n[1], likes, n[4]));
    ASSERT_OK(again.commit());
  }
  ASSERT_OK(f->persist());
  auto other = make_database();
  auto g = must(WorldFile::open(folder / "w", *other));
  const auto t = other->snapshot();
  const auto targets = t.targets(n[1], likes);
  EXPECT_EQ(std::vector<NodeId>(targets.begin(), targets.end()),
            (std::vector<NodeId>{n[2], n[0], n[3], n[4]}));
}

TEST(WorldFile, FollowsASchemaThatGrows) {
  TemporaryFolder folder;
  const auto file = folder / "w";
  auto db = make_database();
  auto f = must(WorldFile::create(file, *db));
  for (std::uint64_t step = 0; step < 30; ++step) test::change(*db, step);
  ASSERT_OK(f->persist());
  ASSERT_TRUE(db->add_attribute(db->schema().require_type("Thing"),
                                {.name = "late", .default_value = Vector3(-0.0, 1, 2)}));
  ASSERT_TRUE(db->define(
      TypeSpec{.name = "Late", .base = "Thing", .attributes = {{.name = "x", .default_value = 1.0}}}));
  ASSERT_TRUE(db->define(EdgeSpec{.name = "later_than"}));
  ASSERT_OK(f->persist());
  auto tx = db->begin();
  const auto node = *tx.create("Late");
  ASSERT_OK(tx.connect(node, db->schema().require_edge("later_than"), node));
  ASSERT_OK(tx.commit());
  ASSERT_OK(f->persist());
  EXPECT_EQ(ask(file, "SELECT \"late.y\", x FROM Late"), "1.0|1.0");
  auto bare = Database::create();
  EXPECT_EQ(reopened(file, *bare), world_yaml(db->snapshot()));
}

TEST(WorldFile, FollowsUndoAndRedo) {
  TemporaryFolder folder;
  auto db = make_database();
  auto f = must(WorldFile::create(folder / "w", *db));
  for (std::uint64_t step = 0; step < 25; ++step) test::change(*db, step);
  ASSERT_OK(f->persist());
  const auto check = [&] {
    ASSERT_OK(f->persist());
    auto other = make_database();
    ASSERT_EQ(reopened(folder / "w", *other), world_yaml(db->snapshot()));
  };
  for (int i = 0; i < 10; ++i) {
    ASSERT_OK(db->undo());
    check();
  }
  for (int i = 0; i < 10; ++i) {
    ASSERT_OK(db->redo());
    check();
  }
}

TEST(WorldFile, CannotBeUndoneIntoNothing) {
  TemporaryFolder folder;
  auto db = make_database();
  test::change(*db, 1);
  {
    auto f = must(WorldFile::create(folder / "w", *db));
    ASSERT_OK(f->persist());
  }
  auto other = make_database();
  auto f = must(WorldFile::open(folder / "w", *other));
  EXPECT_FALSE(other->undo());
  EXPECT_EQ(world_yaml(other->snapshot()), world_yaml(db->snapshot()));
}

TEST(WorldFile, PersistsWhatRulesMadeOfALoadedWorld) {
  TemporaryFolder folder;
  auto db = make_database();
  NodeId node;
  {
    auto tx = db->begin();
    node = *tx.create("SmallThing");
    ASSERT_OK(tx.set(node, "size_m", Value(-3.0)));
    ASSERT_OK(tx.commit());
    auto f = must(WorldFile::create(folder / "w", *db));
    ASSERT_OK(f->persist());
  }
  auto ruled = make_database();
  const auto& s = ruled->schema();
  const auto size = s.require<double>("SmallThing", "size_m");
  ASSERT_OK(ruled->add_rule({.name = "no_negative_size",
                             .when = {.type = s.require_type("SmallThing")},
                             .writes = {size.id},
                             .run = [size](Transaction& tx, std::span<const Change> mine) -> Status {
                               for (const auto& c : mine)
                                 if (const auto* x = tx.get(c.node, size); x && *x < 0)
                                   if (auto r = tx.set(c.node, size, 0.0); !r) return r;
                               return {};
                             }}));
  auto f = must(WorldFile::open(folder / "w", *ruled));
  EXPECT_EQ(*ruled->snapshot().get(node, size), 0.0);
  ASSERT_OK(f->persist());
  EXPECT_EQ(ask(folder / "w", "SELECT size_m FROM SmallThing"), "0.0");
}

TEST(WorldFile, TouchesOnlyWhatChanged) {
  TemporaryFolder folder;
  const auto file = folder / "w";
  auto db = make_database();
  NodeId big, small;
  {
    auto tx = db->begin();
    big = *tx.create("Thing");
    small = *tx.create("Thing");
    ASSERT_OK(tx.set(big, "a_blob", Value(Blob(std::vector<std::byte>(1 << 20)))));
    ASSERT_OK(tx.commit());
  }
  auto f = must(WorldFile::create(file, *db));
  ASSERT_OK(f->persist());
  // By hand, behind the store's back: what it does not touch stays.
  ask(file, "UPDATE Thing SET a_text = 'by hand', a_integer = 99");
  auto tx = db->begin();
  ASSERT_OK(tx.set(small, "a_integer", Value(std::int64_t{1})));
  ASSERT_OK(tx.commit());
  ASSERT_OK(f->persist());
  EXPECT_EQ(ask(file, "SELECT a_text, a_integer FROM Thing ORDER BY id"), "by hand|99|by hand|1");
}

TEST(WorldFile, IsWrittenByOneAtATime) {
  TemporaryFolder folder;
  const auto file = folder / "w";
  auto a = make_database(), b = make_database();
  auto fa = must(WorldFile::create(file, *a));
  ASSERT_OK(fa->persist());
  auto fb = must(WorldFile::open(file, *b));
  test::change(*a, 1);
  test::change(*b, 2);
  ASSERT_OK(fa->persist());
  const auto s = fb->persist();
  ASSERT_FALSE(s);
  EXPECT_EQ(s.error().code, ErrorCode::io);
  EXPECT_NE(s.error().message.find("another program"), std::string::npos) << s.error().text();
  auto other = make_database();
  EXPECT_EQ(reopened(file, *other), world_yaml(a->snapshot()));
}

}  // namespace
}  // namespace rigor::world
