// The demo's own loop under the guard: real channels, recorder, digest, application, and nothing in it that
// could wait.
#include <gtest/gtest.h>

#include "cli/assembly.h"
#include "cli/backends.h"
#include "cli/recording.h"
#include "rt-core/realtime_guard.h"
#include "tests/cli/command.h"

namespace rigor {
namespace {

TEST(RunGuard, TheDemosLoopDoesNotAllocateLockFaultOrBlock) {
  test::TempDir dir;
  auto rig = load_rig(test::config("demo.yaml"), {});
  ASSERT_TRUE(rig) << rig.error().text();
  rig->duration = seconds(2);
  rig->record.file = dir / "run.mcap";
  const Registry registry = make_registry();
  auto devices = DeviceWorld::open(*rig);
  ASSERT_TRUE(devices) << devices.error().text();
  std::vector<std::unique_ptr<Emulator>> emulators;
  for (const EmulatorEntry& entry : rig->emulators) {
    auto emulator = (*devices)->start_emulator(entry, registry, bench_now());
    ASSERT_TRUE(emulator) << emulator.error().text();
    emulators.push_back(std::move(*emulator));
  }
  auto assembly = assemble(std::move(*rig), registry);
  ASSERT_TRUE(assembly) << assembly.error().text();
  RunParts& parts = (*assembly)->parts;
  BenchRun run(parts, nullptr);
  ASSERT_TRUE(run.arm());
  const BenchTime t0 = bench_now() + seconds(1);
  auto recorder = open_recording(parts, t0, read_epoch(), {});
  ASSERT_TRUE(recorder) << recorder.error().text();
  run.set_recorder(recorder->get());
  const Status installed = guard::install();
  ASSERT_TRUE(installed) << installed.error().text();
  guard::clear();
  auto outcome = run.run({}, t0);
  const guard::Report report = guard::report();
  guard::uninstall();
  ASSERT_TRUE(outcome) << outcome.error().text();
  EXPECT_GT(outcome->loop.cycles_run, 500u);
  EXPECT_EQ(report.allocations, 0u) << report.text();
  EXPECT_EQ(report.locks, 0u) << report.text();
  EXPECT_EQ(report.system_calls, 0u) << report.text();
  bool locked = false;
  for (const RealtimeSetting& s : outcome->loop.settings) locked |= s.name == "memory lock" && s.granted;
  EXPECT_TRUE(!locked || report.page_faults == 0) << report.text();
  EXPECT_TRUE(run.stop());
  EXPECT_TRUE((*recorder)->stop());
  for (auto& e : emulators) EXPECT_TRUE(e->stop());
}

}  // namespace
}  // namespace rigor
