// What persist() has acknowledged survives a loss of power at any instant, and a disk that fills up.
#include <gtest/gtest.h>

#include "sim/world/store/world_file.h"
#include "tests/sim/world/store/simulated_disk.h"
#include "tests/sim/world/store/test_world.h"

namespace rigor::world {
namespace {

using test::Draws;
using test::make_database;
using test::SimulatedDisk;

constexpr const char* kFile = "/disk/world.rigor";
constexpr std::size_t kPersists = 8, kStepsEach = 4;

void steps(Database& db, std::size_t persist) {
  for (std::size_t i = 0; i < kStepsEach; ++i) test::change(db, persist * kStepsEach + i);
}

/// The world as YAML after 0, 1, 2 … persists.
const std::vector<std::string>& expected() {
  static const auto all = [] {
    auto db = make_database();
    std::vector<std::string> out = {world_yaml(db->snapshot())};
    for (std::size_t k = 0; k < kPersists; ++k) {
      steps(*db, k);
      out.push_back(world_yaml(db->snapshot()));
    }
    return out;
  }();
  return all;
}

struct Outcome {
  bool created = false;
  std::size_t acknowledged = 0;
};

/// Persists until something fails.
Outcome run() {
  Outcome o;
  auto db = make_database();
  auto file = WorldFile::create(kFile, *db);
  if (!file) return o;
  o.created = true;
  while (o.acknowledged < kPersists) {
    steps(*db, o.acknowledged);
    if (!(*file)->persist()) return o;
    ++o.acknowledged;
  }
  return o;
}

TEST(PowerLoss, LosesNothingThatWasAcknowledged) {
  std::uint64_t operations = 0;
  {
    SimulatedDisk disk;
    ASSERT_EQ(run().acknowledged, kPersists);
    operations = disk.operations();
  }
  Draws draws(20'240'601);
  int unfinished_kept = 0, unfinished_undone = 0, hot_journals = 0;
  for (int trial = 0; trial < 200; ++trial) {
    SimulatedDisk disk;
    const auto instant = draws.below(operations);
    disk.fail_power_at(instant);
    const auto o = run();
    ASSERT_TRUE(disk.power_failed());
    disk.crash(draws.word());
    hot_journals += disk.contains(std::string(kFile) + "-journal");
    auto db = make_database();
    auto file = WorldFile::open(kFile, *db);
    if (!o.created && !file) {
      EXPECT_EQ(file.error().exit_status(), 2) << file.error().text();
      continue;
    }
    ASSERT_TRUE(file) << "instant " << instant << ", " << o.acknowledged
                      << " acknowledged: " << file.error().text();
    const auto yaml = world_yaml(db->snapshot());
    const bool kept = o.acknowledged < kPersists && yaml == expected()[o.acknowledged + 1];
    ASSERT_TRUE(kept || yaml == expected()[o.acknowledged])
        << "instant " << instant << ": " << o.acknowledged << " acknowledged";
    (kept ? unfinished_kept : unfinished_undone) += 1;
    // And it goes on from there.
    for (std::size_t k = o.acknowledged + (kept ? 1 : 0); k < kPersists; ++k) steps(*db, k);
    const auto s = (*file)->persist();
    ASSERT_TRUE(s) << s.error().text();
    auto again = make_database();
    ASSERT_TRUE(WorldFile::open(kFile, *again));
    ASSERT_EQ(world_yaml(again->snapshot()), world_yaml(db->snapshot()));
  }
  // The instants meant something: unfinished writes were undone from journals, and some were complete.
  EXPECT_GT(hot_journals, 20);
  EXPECT_GT(unfinished_undone, 20);
  EXPECT_GT(unfinished_kept, 0);
}

/// How often a plain SQLite client with these settings loses, of 200 losses of power, what was acknowledged
/// or the whole file.
int losses(const char* pragmas) {
  int lost = 0;
  Draws draws(7);
  for (int trial = 0; trial < 200; ++trial) {
    SimulatedDisk disk;
    int acknowledged = 0;
    disk.fail_power_at(draws.below(300));
    sqlite3* db = nullptr;
    sqlite3_open(kFile, &db);
    sqlite3_exec(db, pragmas, nullptr, nullptr, nullptr);
    bool on = sqlite3_exec(db, "CREATE TABLE t(x)", nullptr, nullptr, nullptr) == SQLITE_OK;
    for (int i = 1; i < 100 && on; ++i) {
      on = sqlite3_exec(db, "INSERT INTO t VALUES(randomblob(3000))", nullptr, nullptr, nullptr) == SQLITE_OK;
      acknowledged += on;
    }
    sqlite3_close(db);
    disk.crash(draws.word());
    int found = -1;
    sqlite3_open(kFile, &db);
    sqlite3_exec(
        db, "SELECT count(*) FROM t WHERE length(x) = 3000",
        [](void* out, int, char** v, char**) { return *static_cast<int*>(out) = std::atoi(v[0]), 0; }, &found,
        nullptr);
    sqlite3_close(db);
    lost += acknowledged > 0 && found < acknowledged;
  }
  return lost;
}

// The simulated disk is as hard as it says: it catches both settings that are weaker than the store's.
TEST(PowerLoss, IsLostWithWeakerSettings) {
  EXPECT_GT(losses("PRAGMA synchronous = OFF"), 50);
  EXPECT_GT(losses("PRAGMA synchronous = FULL"), 0) << "a deleted journal that comes back";
  EXPECT_EQ(losses("PRAGMA synchronous = EXTRA"), 0);
}

TEST(DiskFull, KeepsTheLastStateAndGoesOn) {
  std::uint64_t writes = 0, created = 0;
  {
    SimulatedDisk disk;
    auto db = make_database();
    ASSERT_TRUE(WorldFile::create(kFile, *db));
    created = disk.writes();
  }
  {
    SimulatedDisk disk;
    ASSERT_EQ(run().acknowledged, kPersists);
    writes = disk.writes();
  }
  int refusals = 0;
  const auto stride = 1 + (writes - created) / 150;
  for (std::uint64_t at = created; at < writes; at += stride) {
    SimulatedDisk disk;
    disk.fill_at(at);
    auto db = make_database();
    auto file = WorldFile::create(kFile, *db);
    ASSERT_TRUE(file) << file.error().text();
    for (std::size_t k = 0; k < kPersists; ++k) {
      steps(*db, k);
      auto s = (*file)->persist();
      if (s) continue;
      ++refusals;
      ASSERT_EQ(s.error().code, ErrorCode::disk_full) << s.error().text();
      auto kept = make_database();
      auto reader = WorldFile::open(kFile, *kept, WorldFile::Access::read_write);
      ASSERT_TRUE(reader) << "write " << at << ": " << reader.error().text();
      ASSERT_EQ(world_yaml(kept->snapshot()), expected()[k]) << "write " << at;
      s = (*file)->persist();
      ASSERT_TRUE(s) << s.error().text();
    }
    auto last = make_database();
    ASSERT_TRUE(WorldFile::open(kFile, *last));
    ASSERT_EQ(world_yaml(last->snapshot()), expected().back()) << "write " << at;
  }
  EXPECT_GT(refusals, 50);
}

TEST(DiskFull, IsToldUntilThereIsRoom) {
  SimulatedDisk disk;
  auto db = make_database();
  auto file = WorldFile::create(kFile, *db);
  ASSERT_TRUE(file);
  steps(*db, 0);
  ASSERT_TRUE((*file)->persist());
  disk.limit(disk.bytes() + 100'000);
  {
    auto tx = db->begin();
    ASSERT_TRUE(tx.set(*tx.create("Thing"), "a_blob", Value(Blob(std::vector<std::byte>(1 << 20)))));
    ASSERT_TRUE(tx.commit());
  }
  for (int i = 0; i < 3; ++i) {
    const auto s = (*file)->persist();
    ASSERT_FALSE(s);
    EXPECT_EQ(s.error().code, ErrorCode::disk_full) << s.error().text();
    EXPECT_EQ(s.error().exit_status(), 1);
  }
  disk.limit(std::nullopt);
  const auto s = (*file)->persist();
  ASSERT_TRUE(s) << s.error().text();
  auto again = make_database();
  ASSERT_TRUE(WorldFile::open(kFile, *again));
  EXPECT_EQ(world_yaml(again->snapshot()), world_yaml(db->snapshot()));
}

TEST(DiskFull, LeavesNoFileThatCouldNotBeMade) {
  SimulatedDisk disk;
  disk.limit(10'000);
  auto db = make_database();
  const auto file = WorldFile::create(kFile, *db);
  ASSERT_FALSE(file);
  EXPECT_EQ(file.error().code, ErrorCode::disk_full) << file.error().text();
}

}  // namespace
}  // namespace rigor::world
