// A process that persists is killed at random instants: the file opens each time, with what was acknowledged.
#include <gtest/gtest.h>
#include <poll.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <csignal>
#include <thread>

#include "sim/world/store/world_file.h"
#include "tests/sim/world/store/test_world.h"

namespace rigor::world {
namespace {

using test::make_database;
using test::TemporaryFolder;

constexpr std::uint64_t kMaxPersists = 60;

/// The child: one step, one persist, one byte through the pipe.
[[noreturn]] void persist_for_ever(const std::filesystem::path& path, int pipe) {
  auto db = make_database();
  auto file = WorldFile::create(path, *db);
  if (!file) ::_exit(1);
  for (std::uint64_t k = 0; k < kMaxPersists; ++k) {
    test::change(*db, k);
    if (!(*file)->persist()) ::_exit(2);
    if (::write(pipe, "k", 1) != 1) ::_exit(3);
  }
  ::_exit(0);
}

TEST(Kill, LosesNothingThatWasAcknowledged) {
  std::vector<std::string> expected;
  {
    auto db = make_database();
    expected.push_back(world_yaml(db->snapshot()));
    for (std::uint64_t k = 0; k < kMaxPersists; ++k) {
      test::change(*db, k);
      expected.push_back(world_yaml(db->snapshot()));
    }
  }
  test::Draws draws(99);
  int amid = 0, journals = 0;
  for (int trial = 0; trial < 200; ++trial) {
    TemporaryFolder folder;
    const auto path = folder / "w";
    int ends[2];
    ASSERT_EQ(::pipe(ends), 0);
    const auto child = ::fork();
    ASSERT_GE(child, 0);
    if (child == 0) persist_for_ever(path, ends[1]);
    ::close(ends[1]);
    // The instant: a random time after a random acknowledgement.
    std::uint64_t acknowledged = 0;
    char byte = 0;
    for (auto wait_for = draws.below(12); acknowledged < wait_for && ::read(ends[0], &byte, 1) == 1;)
      ++acknowledged;
    std::this_thread::sleep_for(std::chrono::microseconds(draws.below(4000)));
    ::kill(child, SIGKILL);
    int status = 0;
    ASSERT_EQ(::waitpid(child, &status, 0), child);
    while (::read(ends[0], &byte, 1) == 1) ++acknowledged;
    ::close(ends[0]);
    amid += WIFSIGNALED(status);
    ASSERT_TRUE(WIFSIGNALED(status) || WEXITSTATUS(status) == 0) << WEXITSTATUS(status);
    std::error_code ec;
    journals += std::filesystem::file_size(path.string() + "-journal", ec) > 0 && !ec;

    auto db = make_database();
    const auto file = WorldFile::open(path, *db);
    if (acknowledged == 0 && !file) {  // killed before the file was made
      EXPECT_EQ(file.error().exit_status(), 2) << file.error().text();
      continue;
    }
    ASSERT_TRUE(file) << "trial " << trial << ", " << acknowledged
                      << " acknowledged: " << file.error().text();
    const auto yaml = world_yaml(db->snapshot());
    ASSERT_TRUE(yaml == expected[acknowledged] ||
                (acknowledged < kMaxPersists && yaml == expected[acknowledged + 1]))
        << "trial " << trial << ", " << acknowledged << " acknowledged";
  }
  EXPECT_GT(amid, 150) << "most were killed at work";
  EXPECT_GT(journals, 10) << "and many amid a write";
}

}  // namespace
}  // namespace rigor::world
