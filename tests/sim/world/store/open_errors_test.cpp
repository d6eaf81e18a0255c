// Files that are no world, or not whole, or from another time: what the user is told, and that nothing is
// touched. Worlds of version 1 open.
#include <gtest/gtest.h>
#include <sqlite3.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <fstream>
#include <functional>

#include "sim/world/store/world_file.h"
#include "tests/sim/world/store/test_world.h"

namespace rigor::world {
namespace {

using test::make_database;
using test::TemporaryFolder;
namespace fs = std::filesystem;

std::string bytes_of(const fs::path& file) {
  std::ifstream in(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}
void write(const fs::path& file, const std::string& bytes) {
  std::ofstream(file, std::ios::binary).write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
}
void sql(const fs::path& file, const std::string& text) {
  sqlite3* db = nullptr;
  char* error = nullptr;
  ASSERT_EQ(sqlite3_open(file.c_str(), &db), SQLITE_OK);
  sqlite3_exec(db, text.c_str(), nullptr, nullptr, &error);
  EXPECT_EQ(error, nullptr) << error;
  sqlite3_free(error);
  sqlite3_close(db);
}

class OpenErrors : public ::testing::Test {
 protected:
  /// A world of some steps; its YAML is `yaml_`.
  void make(const fs::path& file) {
    auto db = make_database();
    for (std::uint64_t step = 0; step < 40; ++step) test::change(*db, step);
    auto f = WorldFile::create(file, *db);
    ASSERT_TRUE(f) << f.error().text();
    const auto s = (*f)->persist();
    ASSERT_TRUE(s) << s.error().text();
    yaml_ = world_yaml(db->snapshot());
  }
  /// Opens in vain: exit status 2, the file in the message, all words in it; file and database as before.
  void refused(const fs::path& file, ErrorCode code, std::initializer_list<std::string_view> words) {
    const auto before = fs::is_regular_file(file) ? bytes_of(file) : "";
    auto db = make_database();
    const auto f = WorldFile::open(file, *db);
    ASSERT_FALSE(f);
    const auto text = f.error().text();
    EXPECT_EQ(f.error().code, code) << text;
    EXPECT_EQ(f.error().exit_status(), 2) << text;
    EXPECT_NE(text.find(file.string()), std::string::npos) << text;
    for (const auto w : words) EXPECT_NE(text.find(w), std::string::npos) << "'" << w << "' in: " << text;
    EXPECT_EQ(fs::is_regular_file(file) ? bytes_of(file) : "", before);
    EXPECT_EQ(db->snapshot().node_count(), 0U);
    auto tx = db->begin();
    EXPECT_TRUE(tx.create("Thing")) << "the database is free for something else";
  }
  TemporaryFolder folder_;
  std::string yaml_;
};

TEST_F(OpenErrors, NothingThere) {
  refused(folder_ / "none", ErrorCode::not_found, {"no such file", "check the name"});
  refused(folder_ / "no_folder/none", ErrorCode::not_found, {"no such file"});
  EXPECT_FALSE(fs::exists(folder_ / "none"));
}

TEST_F(OpenErrors, AFolder) {
  refused(folder_.path(), ErrorCode::bad_input, {"got a folder", "name a file"});
}

TEST_F(OpenErrors, AnEmptyFile) {
  write(folder_ / "w", "");
  refused(folder_ / "w", ErrorCode::bad_input, {"empty file", "remove it"});
}

TEST_F(OpenErrors, AnotherKindOfFile) {
  write(folder_ / "w", "rigor_world: 1\nnodes: []\n" + std::string(5000, '#'));
  refused(folder_ / "w", ErrorCode::bad_input, {"a file of another kind"});
  write(folder_ / "x", "SQLite format 3");
  refused(folder_ / "x", ErrorCode::bad_input, {});
}

TEST_F(OpenErrors, AnSqliteFileOfAnotherProgram) {
  sql(folder_ / "w", "CREATE TABLE nodes(id INTEGER PRIMARY KEY); INSERT INTO nodes VALUES(1)");
  refused(folder_ / "w", ErrorCode::bad_input, {"another program"});
}

TEST_F(OpenErrors, ANewerVersion) {
  make(folder_ / "w");
  sql(folder_ / "w", "PRAGMA user_version = 3; UPDATE meta SET value = 3 WHERE key = 'schema_version'");
  refused(folder_ / "w", ErrorCode::bad_input, {"version 2 or older", "version 3", "newer Rigor"});
}

TEST_F(OpenErrors, AVersionThatNeverWas) {
  make(folder_ / "w");
  sql(folder_ / "w", "PRAGMA user_version = 0");
  refused(folder_ / "w", ErrorCode::bad_input, {"version 0"});
}

TEST_F(OpenErrors, CutShortAnywhere) {
  make(folder_ / "w");
  const auto whole = bytes_of(folder_ / "w");
  for (const double share : {0.001, 0.01, 0.2, 0.5, 0.9, 0.999}) {
    write(folder_ / "cut",
          whole.substr(0, static_cast<std::size_t>(share * static_cast<double>(whole.size()))));
    refused(folder_ / "cut", ErrorCode::bad_input, {});
  }
  write(folder_ / "cut", whole.substr(0, whole.size() - 4096));
  refused(folder_ / "cut", ErrorCode::bad_input, {"cut short", "copy"});
}

TEST_F(OpenErrors, DamagedAnywhere) {
  make(folder_ / "w");
  const auto whole = bytes_of(folder_ / "w");
  test::Draws draws(5);
  int refusals = 0;
  for (int i = 0; i < 150; ++i) {
    auto bytes = whole;
    const auto at = draws.below(bytes.size());
    for (std::size_t k = at; k < std::min(at + 1 + draws.below(64), bytes.size()); ++k)
      bytes[k] = static_cast<char>(draws.word());
    write(folder_ / "x", bytes);
    auto db = make_database();
    const auto f = WorldFile::open(folder_ / "x", *db, WorldFile::Access::read_only);
    if (f) continue;  // a value, or free space
    ++refusals;
    EXPECT_EQ(f.error().exit_status(), 2) << f.error().text();
    EXPECT_EQ(db->snapshot().node_count(), 0U);
  }
  EXPECT_GT(refusals, 5);
}

TEST_F(OpenErrors, ValuesThatDoNotFit) {
  const auto spoil = [&](const std::string& change, std::initializer_list<std::string_view> words) {
    fs::remove(folder_ / "w");
    make(folder_ / "w");
    sql(folder_ / "w", "PRAGMA foreign_keys = OFF; " + change);
    refused(folder_ / "w", ErrorCode::bad_input, words);
  };
  spoil("UPDATE Thing SET a_flag = 2", {"a_flag", "expected a flag", "node "});
  spoil("UPDATE Thing SET a_number = 'three'", {"a_number", "expected a number"});
  spoil("UPDATE Thing SET a_numbers = x'0011'", {"a_numbers"});
  spoil("UPDATE Thing SET \"a_pose.r11\" = 'x'", {"a_pose"});
  spoil("UPDATE Thing SET a_text = NULL", {"a_text", "expected a text"});
  spoil("DELETE FROM Thing WHERE id = (SELECT min(id) FROM Thing)", {"table nodes", "mend it"});
  spoil("INSERT INTO edges SELECT 999999, id, 0, 1 FROM edge_types", {"999999"});
  spoil("INSERT INTO dynamic_attributes VALUES((SELECT min(id) FROM nodes), 'zz', 'colour', 1)",
        {"zz", "colour"});
  spoil("ALTER TABLE Thing DROP COLUMN a_integer", {"a_integer"});
  spoil("DROP TABLE edges", {"edges"});
  spoil("UPDATE attributes SET kind = 'colour' WHERE name = 'a_text'", {"a_text", "colour"});
}

TEST_F(OpenErrors, TypesThatDiffer) {
  const auto against = [&](TypeSpec thing, std::initializer_list<std::string_view> words) {
    auto db = Database::create();
    ASSERT_TRUE(db->define(thing));
    const auto count = db->schema().type_count();
    const auto f = WorldFile::open(folder_ / "w", *db);
    ASSERT_FALSE(f);
    EXPECT_EQ(f.error().code, ErrorCode::bad_input);
    for (const auto w : words) EXPECT_NE(f.error().text().find(w), std::string::npos) << f.error().text();
    EXPECT_EQ(db->schema().type_count(), count) << "nothing was defined";
  };
  make(folder_ / "w");
  against({.name = "Thing", .attributes = {{.name = "a_text", .default_value = 1.0}}},
          {"Thing.a_text", "expected number", "got text"});
  against({.name = "Thing", .attributes = {{.name = "a_number", .default_value = 1.0, .unit = "m"}}},
          {"Thing.a_number", "unit 'm'"});
  against({.name = "Plan"}, {"Plan", "base Object", "Idea"});
  against({.name = "Thing", .abstract = true}, {"Thing", "abstract"});
}

TEST_F(OpenErrors, ADatabaseThatHoldsNodes) {
  make(folder_ / "w");
  auto db = make_database();
  test::change(*db, 1);
  const auto f = WorldFile::open(folder_ / "w", *db);
  ASSERT_FALSE(f);
  EXPECT_EQ(f.error().code, ErrorCode::wrong_state);
}

TEST_F(OpenErrors, ARuleThatRefusesTheWorld) {
  make(folder_ / "w");
  auto db = make_database();
  ASSERT_TRUE(db->add_rule({.name = "no_things",
                            .when = {.type = db->schema().require_type("Thing")},
                            .run = [](Transaction&, std::span<const Change>) -> Status {
                              return fail(ErrorCode::bad_input, "", "no things here");
                            }}));
  const auto f = WorldFile::open(folder_ / "w", *db);
  ASSERT_FALSE(f);
  EXPECT_EQ(f.error().exit_status(), 2);
  EXPECT_NE(f.error().text().find("no_things"), std::string::npos) << f.error().text();
  EXPECT_EQ(db->snapshot().node_count(), 0U);
}

TEST_F(OpenErrors, CreateOverSomethingThatIsThere) {
  make(folder_ / "w");
  write(folder_ / "empty", "");
  auto db = make_database();
  for (const auto* name : {"w", "empty"}) {
    const auto before = bytes_of(folder_ / name);
    const auto f = WorldFile::create(folder_ / name, *db);
    ASSERT_FALSE(f);
    EXPECT_EQ(f.error().code, ErrorCode::bad_input) << f.error().text();
    EXPECT_EQ(bytes_of(folder_ / name), before);
  }
  const auto nowhere = WorldFile::create(folder_ / "no/such/w", *db);
  ASSERT_FALSE(nowhere);
  EXPECT_EQ(nowhere.error().code, ErrorCode::not_writable) << nowhere.error().text();
  EXPECT_EQ(nowhere.error().exit_status(), 2);
}

TEST_F(OpenErrors, AFileThatWentAway) {
  auto db = make_database();
  auto f = WorldFile::create(folder_ / "w", *db);
  ASSERT_TRUE(f);
  test::change(*db, 1);
  fs::rename(folder_ / "w", folder_ / "v");
  auto s = (*f)->persist();
  ASSERT_FALSE(s);
  EXPECT_NE(s.error().message.find("moved or removed"), std::string::npos) << s.error().text();
  fs::rename(folder_ / "v", folder_ / "w");
  s = (*f)->persist();
  ASSERT_TRUE(s) << s.error().text();
}

TEST_F(OpenErrors, ALockedFile) {
  auto db = make_database();
  auto f = WorldFile::create(folder_ / "w", *db);
  ASSERT_TRUE(f);
  test::change(*db, 1);
  sqlite3* other = nullptr;
  ASSERT_EQ(sqlite3_open((folder_ / "w").c_str(), &other), SQLITE_OK);
  ASSERT_EQ(sqlite3_exec(other, "BEGIN EXCLUSIVE", nullptr, nullptr, nullptr), SQLITE_OK);
  auto s = (*f)->persist();
  ASSERT_FALSE(s);
  EXPECT_EQ(s.error().code, ErrorCode::io);
  EXPECT_NE(s.error().message.find("locked"), std::string::npos) << s.error().text();
  sqlite3_close(other);
  s = (*f)->persist();
  EXPECT_TRUE(s) << s.error().text();
}

TEST_F(OpenErrors, WithoutTheRightToWrite) {
  make(folder_ / "w");
  ASSERT_EQ(::chmod((folder_ / "w").c_str(), 0444), 0);
  ASSERT_EQ(::chmod(folder_.path().c_str(), 0555), 0);
  // Root may write anything: a child without rights tries.
  const auto child = ::fork();
  ASSERT_GE(child, 0);
  if (child == 0) {
    if (::geteuid() == 0 && ::setuid(65534) != 0) ::_exit(9);
    auto db = make_database();
    const auto f = WorldFile::open(folder_ / "w", *db);
    if (f) ::_exit(1);
    if (f.error().code != ErrorCode::not_writable || f.error().exit_status() != 2) ::_exit(2);
    auto reading = WorldFile::open(folder_ / "w", *db, WorldFile::Access::read_only);
    if (!reading) ::_exit(3);
    if (world_yaml(db->snapshot()) != yaml_) ::_exit(4);
    const auto s = (*reading)->persist();
    if (s || s.error().code != ErrorCode::not_writable) ::_exit(5);
    const auto made = WorldFile::create(folder_ / "new", *db);
    if (made || made.error().code != ErrorCode::not_writable) ::_exit(6);
    ::_exit(0);
  }
  int status = 0;
  ASSERT_EQ(::waitpid(child, &status, 0), child);
  EXPECT_TRUE(WIFEXITED(status));
  EXPECT_EQ(WEXITSTATUS(status), 0);
  ::chmod(folder_.path().c_str(), 0755);
}

// ---------------------------------------------------------------- migrations

/// As version 1 wrote it: edges in the order of their rows, no names of tables, no next id.
constexpr const char* kVersion1 = R"sql(
PRAGMA application_id = 1382510450; PRAGMA user_version = 1;
CREATE TABLE meta(key TEXT PRIMARY KEY, value) WITHOUT ROWID;
INSERT INTO meta VALUES('schema_version', 1);
CREATE TABLE types(id INTEGER PRIMARY KEY, name TEXT NOT NULL UNIQUE, base INTEGER REFERENCES types(id),
  abstract INTEGER NOT NULL, place_attribute TEXT NOT NULL, meaning TEXT NOT NULL);
INSERT INTO types VALUES(1, 'Object', NULL, 0, '', ''), (2, 'Plant', 1, 1, '', 'Grows.'),
  (3, 'Oak', 2, 0, 'foot', 'A tree.');
CREATE TABLE attributes(id INTEGER PRIMARY KEY, type INTEGER NOT NULL REFERENCES types(id), name TEXT NOT NULL,
  kind TEXT NOT NULL, unit TEXT NOT NULL, meaning TEXT NOT NULL, transient INTEGER NOT NULL,
  min REAL NOT NULL, max REAL NOT NULL, nan_is_unknown INTEGER NOT NULL, default_value, UNIQUE(type, name));
INSERT INTO attributes VALUES(1, 2, 'height_m', 'number', 'm', '', 0, 0.0, 9e999, 1, 2.5),
  (2, 3, 'foot', 'vector3', 'm', '', 0, -9e999, 9e999, 0, zeroblob(24));
CREATE TABLE attribute_choices(attribute INTEGER NOT NULL REFERENCES attributes(id), position INTEGER NOT NULL,
  word TEXT NOT NULL, PRIMARY KEY(attribute, position)) WITHOUT ROWID;
CREATE TABLE edge_types(id INTEGER PRIMARY KEY, name TEXT NOT NULL UNIQUE, from_type TEXT NOT NULL,
  to_type TEXT NOT NULL, targets_per_source TEXT NOT NULL, sources_per_target TEXT NOT NULL,
  acyclic INTEGER NOT NULL, removes_sources INTEGER NOT NULL, meaning TEXT NOT NULL);
INSERT INTO edge_types VALUES(1, 'near', 'Object', 'Object', 'many', 'many', 0, 0, '');
CREATE TABLE nodes(id INTEGER PRIMARY KEY, type INTEGER NOT NULL REFERENCES types(id));
INSERT INTO nodes VALUES(1, 3), (2, 3), (5, 3);
CREATE TABLE "Object"(id INTEGER PRIMARY KEY);
CREATE TABLE "Oak"(id INTEGER PRIMARY KEY, height_m REAL, "foot.x" REAL, "foot.y" REAL, "foot.z" REAL);
INSERT INTO Oak VALUES(1, 20.5, 1.0, 2.0, 3.0), (2, NULL, 0.0, 0.0, 0.0), (5, 3.0, 0.0, 0.0, 0.0);
CREATE TABLE edges(source INTEGER NOT NULL, type INTEGER NOT NULL, target INTEGER NOT NULL);
INSERT INTO edges VALUES(1, 1, 5), (2, 1, 1), (1, 1, 2);
CREATE TABLE dynamic_attributes(node INTEGER NOT NULL, name TEXT NOT NULL, kind TEXT NOT NULL, value,
  PRIMARY KEY(node, name));
INSERT INTO dynamic_attributes VALUES(5, 'note', 'text', 'old');
)sql";

void expect_version_1(Database& db) {
  const auto w = db.snapshot();
  ASSERT_EQ(w.node_count(), 3U);
  EXPECT_EQ(std::get<double>(*w.get(NodeId{1}, "height_m")), 20.5);
  EXPECT_TRUE(std::isnan(std::get<double>(*w.get(NodeId{2}, "height_m"))));
  EXPECT_EQ(std::get<Vector3>(*w.get(NodeId{1}, "foot")), Vector3(1, 2, 3));
  EXPECT_EQ(std::get<std::string>(*w.get(NodeId{5}, "note")), "old");
  const auto near = w.targets(NodeId{1}, db.schema().require_edge("near"));
  EXPECT_EQ(std::vector<NodeId>(near.begin(), near.end()), (std::vector<NodeId>{NodeId{5}, NodeId{2}}));
}

TEST(Migration, OpensVersion1AndMakesIt2) {
  TemporaryFolder folder;
  sql(folder / "w", kVersion1);
  {
    auto db = Database::create();
    auto f = WorldFile::open(folder / "w", *db);
    ASSERT_TRUE(f) << f.error().text();
    expect_version_1(*db);
    auto tx = db->begin();
    const auto made = tx.create("Oak");
    ASSERT_TRUE(made);
    EXPECT_EQ(*made, NodeId{6});
    ASSERT_TRUE(tx.commit());
    const auto s = (*f)->persist();
    ASSERT_TRUE(s) << s.error().text();
  }
  auto db = Database::create();
  ASSERT_TRUE(WorldFile::open(folder / "w", *db));
  EXPECT_EQ(db->snapshot().node_count(), 4U);
  sqlite3* raw = nullptr;
  sqlite3_open((folder / "w").c_str(), &raw);
  int version = 0;
  sqlite3_exec(
      raw, "PRAGMA user_version",
      [](void* out, int, char** v, char**) { return *static_cast<int*>(out) = std::atoi(v[0]), 0; }, &version,
      nullptr);
  sqlite3_close(raw);
  EXPECT_EQ(version, 2);
}

TEST(Migration, ReadsVersion1AndLeavesIt) {
  TemporaryFolder folder;
  sql(folder / "w", kVersion1);
  const auto before = bytes_of(folder / "w");
  auto db = Database::create();
  const auto f = WorldFile::open(folder / "w", *db, WorldFile::Access::read_only);
  ASSERT_TRUE(f) << f.error().text();
  expect_version_1(*db);
  EXPECT_EQ(bytes_of(folder / "w"), before);
}

TEST(Migration, LeavesVersion1WhereItFails) {
  TemporaryFolder folder;
  sql(folder / "w", std::string(kVersion1) + "CREATE TABLE edges_1(x);");
  const auto before = bytes_of(folder / "w");
  auto db = Database::create();
  const auto f = WorldFile::open(folder / "w", *db);
  ASSERT_FALSE(f);
  EXPECT_EQ(f.error().exit_status(), 2) << f.error().text();
  EXPECT_EQ(bytes_of(folder / "w"), before);
}

}  // namespace
}  // namespace rigor::world
