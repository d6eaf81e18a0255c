// Every rig below configs/ runs in virtual time, with recording, digest and report, and is replayed: what the
// application saw of each kind of driver and sink is seen again from the recording. Where there is a guard,
// the loop runs under it and does not allocate. One case a rig; the list is read when the binary starts.
#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <set>

#include "bench/bench.h"
#include "bench/run/replay_assembly.h"
#include "builtin/registry.h"
#include "tests/cli/command.h"
#include "tests/cli/rigs_of_the_tree.h"
#ifdef RIGOR_WITH_GUARD
#include "rt-core/realtime_guard.h"
#include "tests/paths.h"
#endif

namespace rigor::test {
namespace {

class EveryRig : public testing::TestWithParam<Rig> {
 protected:
  static Result<RunReport> run(Result<std::unique_ptr<Bench>> bench) {
    if (!bench) return tl::unexpected<Error>(bench.error());
    if (auto s = (*bench)->prepare(); !s) return tl::unexpected<Error>(s.error());
    return (*bench)->run();
  }
  TempDir dir;
};

TEST_P(EveryRig, LoadsAndRunsWithoutAllocatingInItsLoopAndIsReplayed) {
  std::vector<ConfigOverride> overrides;
  // In place of `rigor tune`, which writes beside the rig.
  if (GetParam().path == "rigs/tuned-scan.yaml")
    overrides.push_back(*ConfigOverride::parse("channels.scan.renderer=rays"));
  auto rig = load_rig(config(GetParam().path), overrides);
  ASSERT_TRUE(rig) << rig.error().text();
  rig->clock = ClockKind::virtual_time;
  rig->duration = milliseconds(200);
  rig->record.file = dir / "any.mcap";
  rig->report = dir / "any";
#ifdef RIGOR_WITH_GUARD
  const Status installed = guard::install();
  ASSERT_TRUE(installed) << installed.error().text();
  guard::clear();
#endif
  const auto report = run(Bench::create(std::move(*rig), make_registry()));
#ifdef RIGOR_WITH_GUARD
  const guard::Report guarded = guard::report();
  guard::uninstall();
  EXPECT_EQ(guarded.allocations, 0u) << guarded.text();
#endif
  ASSERT_TRUE(report) << report.error().text();
  EXPECT_TRUE(report->passed()) << report->text();
  EXPECT_EQ(report->outcome.input_sha256.size(), 64u);
  EXPECT_TRUE(std::filesystem::exists(dir / "any/index.html"));

  auto input = open_replay(dir / "any.mcap");
  ASSERT_TRUE(input) << input.error().text();
  auto recorded = recorded_rig(*input, {}, make_registry(), true);
  ASSERT_TRUE(recorded) << recorded.error().text();
  const auto replay = run(Bench::create_replay(std::move(*recorded), make_registry(), std::move(*input)));
  ASSERT_TRUE(replay) << replay.error().text();
  EXPECT_EQ(replay->replay_difference, "");
  EXPECT_EQ(replay->outcome.input_sha256, report->outcome.input_sha256);
}
INSTANTIATE_TEST_SUITE_P(Tree, EveryRig, testing::ValuesIn(rigs()), name_of);

// The cases above are found by the text `channels:` at the start of a line. Here rigs are found in another
// way: by their folder and by what documents name, so that none drops out of the list unseen.
TEST(Rigs, OfTheRigFolderAndTheDemoAreAllTried) {
  std::set<std::string> tried, there{"demo.yaml"};
  for (const Rig& rig : rigs()) tried.insert(rig.path);
  for (const auto& entry : std::filesystem::directory_iterator(rigor::test::source_dir() + "/configs/rigs"))
    if (entry.path().extension() == ".yaml") there.insert("rigs/" + entry.path().filename().string());
  EXPECT_EQ(tried, there);
}

}  // namespace
}  // namespace rigor::test
