// Loops under the guard in wall-clock time, with their channels, recorder, digest and application: the demo's
// and that with faults, which judges itself while somebody looks on, do not allocate, lock, fault or block.
// (Every rig in virtual time: test_rigs.cpp.)
#include <gtest/gtest.h>

#include <functional>
#include <thread>

#include "bench/run/assembly.h"
#include "bench/run/recording.h"
#include "builtin/registry.h"
#include "rt-core/realtime_guard.h"
#include "sensor-hal/channel/fault_bench.h"
#include "tests/cli/command.h"

namespace rigor {
namespace {

/// Two seconds of a rig; `meanwhile` runs on a thread of its own.
void run_under_guard(const std::string& file, const std::function<void(RunParts&)>& meanwhile = {},
                     const std::vector<ConfigOverride>& overrides = {}) {
  test::TempDir dir;
  auto rig = load_rig(test::config(file), overrides);
  ASSERT_TRUE(rig) << rig.error().text();
  rig->clock = ClockKind::wall;
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
  run.want_digest(true);
  ASSERT_TRUE(run.arm());
  auto output = RecordingFile::create(parts.rig.record.file, Existing::replace);
  ASSERT_TRUE(output) << output.error().text();
  auto recorder = open_recording(parts, *output, read_epoch(), {});
  ASSERT_TRUE(recorder) << recorder.error().text();
  run.set_recorder(recorder->get());
  const Status installed = guard::install();
  ASSERT_TRUE(installed) << installed.error().text();
  guard::clear();
  std::thread other;
  if (meanwhile) other = std::thread([&] { meanwhile(parts); });
  auto outcome = run.run({});
  if (other.joinable()) other.join();
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

TEST(RunGuard, TheDemosLoopDoesNotAllocateLockFaultOrBlock) { run_under_guard("demo.yaml"); }

TEST(RunGuard, NorDoesALoopWithFaultsScheduledAndInjected) {
  const auto expect = ConfigOverride::parse(
      "expect=[{of: right, rate_hz: {min: 1}, missing: {max: 0}, late: {max: 0}, age_ms: {max: 1}, "
      "age_p99_ms: "
      "{max: 1}}, {of: turntable.position, value: {max: 0}, per_s: {max: 0}, until_s: 1}, "
      "{of: table_command.target_rate, value: {max: 0}, per_s: {max: 0}}, {of: table_command, failed: {max: "
      "0}}, "
      "{of: table_command, safe_after_ms: {max: 100}, when: {fault: right}}, {of: table_command, "
      "safe_after_ms: "
      "{max: 100}, when: {channel: turntable, is: overdue}}, {of: left, alarm: false}, {of: loop, skipped: "
      "{max: "
      "0}}]");
  ASSERT_TRUE(expect) << expect.error().text();
  const auto meanwhile = [](RunParts& parts) {
    const auto inject = [&](const std::string& channel, const std::string& yaml) {
      const auto node = ConfigDocument::parse(yaml, "fault");
      ASSERT_TRUE(node);
      const auto injected = parts.faults->inject(channel, *node);
      EXPECT_TRUE(injected) << injected.error().text();
    };
    for (int round = 0; round < 5; ++round) {
      std::this_thread::sleep_for(std::chrono::milliseconds(500));
      for (const char* channel : {"right", "left.real", "left.simulated"}) {
        inject(channel, "{kind: noise, sigma_dn: 9}");
        inject(channel, "{kind: delay, delay_ms: 30, probability: 0.5}");
        inject(channel, "{kind: corrupt, flips: 100, for_s: 0.2}");
      }
      inject("turntable", "{kind: jitter, shape: normal, mean_ms: 8, sigma_ms: 3}");
      inject("turntable", "{kind: stuck, for_s: 0.1}");
      inject("turntable", "{kind: slow_consumer, mode: hold, leases: 4}");
      inject("table_command", "{kind: noise, value: target_rate, sigma: 2}");
      std::this_thread::sleep_for(std::chrono::milliseconds(100));
      EXPECT_TRUE(parts.faults->clear(""));
      RunEnd known;
      known.extent = RunEnd::Extent::so_far;
      EXPECT_EQ(parts.expectations->so_far(known).size(), 14U);
      parts.expectations->ask();
    }
  };
  run_under_guard("rigs/faults.yaml", meanwhile, {*expect});
}

}  // namespace
}  // namespace rigor
