// Ports of a recorded run: what the loop skipped, what the recorder skipped, what a newer sample overtook.
#include "bench/analysis/recorded_ports.h"

#include <gtest/gtest.h>

#include <filesystem>

#include "bench/analysis/check_recording.h"
#include "sensor-hal/record/recorder.h"
#include "tests/cli/command.h"

namespace rigor {
namespace {

constexpr const char* kRig =
    "name: recorded\n"
    "loop: { rate_hz: 1000 }\n"
    "channels:\n"
    "  table: { kind: registers, backend: replay, file: none.mcap, rate_hz: 500, latency_ms: 1 }\n"
    "sinks:\n"
    "  drive: { backend: log, signals: [v] }\n"
    "expect:\n"
    "  - { of: table, age_ms: { max: 2 }, missing: { max: 0 } }\n"
    "  - { of: table.position, value: { max: 9 } }\n"
    "  - { of: drive.v, value: { max: 3 } }\n"
    "  - { of: loop, skipped: { max: 3 } }\n";

/// A recorder that is told of ten cycles as the loop would tell it.
class RecordedPortsTest : public ::testing::Test {
 protected:
  RecordedPortsTest() : file(dir / "run.mcap"), pool(make_sample_pool(64, 0)) {
    RecorderOptions options;
    options.virtual_time = true;
    RecordedChannel table;
    table.name = "table";
    table.description.kind = SampleKind::register_block;
    table.description.names = {"position"};
    table.description.units = {"deg"};
    auto made = Recorder::create(file.string(), options, {table}, {{"drive", {"v"}}},
                                 {{"rigor_run", "1"},
                                  {"rig", kRig},
                                  {"rig_file", "rig.yaml"},
                                  {"epoch_bench_ns", std::to_string(kVirtualEpoch.bench.ns())},
                                  {"epoch_utc_ns", std::to_string(kVirtualEpoch.utc.ns())},
                                  {"epoch_sigma_ns", "0"}});
    EXPECT_TRUE(made) << made.error().text();
    recorder = std::move(*made);
    recorder->begin(BenchTime(0));
  }
  static BenchTime at(std::uint64_t ms) { return BenchTime(0) + milliseconds(static_cast<std::int64_t>(ms)); }
  SampleLease sample(std::uint64_t sequence, std::uint64_t captured_ms, double position) {
    SampleSlot slot = pool->try_acquire();
    Sample& s = *slot;
    s.stamp = {.sequence = sequence,
               .t_capture = at(captured_ms),
               .t_release = at(captured_ms + 1),
               .t_arrival = at(captured_ms + 1)};
    RegisterBlock block;
    block.count = 1;
    block.value[0] = position;
    s.info = block;
    return slot;
  }
  void show(std::uint64_t cycle, PortStatus status, const SampleLease& visible) {
    recorder->record_visibility(0, cycle, at(cycle), status, visible);
  }
  void command(std::uint64_t cycle, double v) {
    Command c;
    c.t_issue = c.t_effect = at(cycle);
    c.count = 1;
    c.value[0] = v;
    recorder->record_command(0, c);
  }
  void end(std::uint64_t cycle) { recorder->end_cycle(cycle, at(cycle)); }

  test::TempDir dir;
  std::filesystem::path file;
  std::unique_ptr<SamplePool> pool;
  std::unique_ptr<Recorder> recorder;
};

TEST_F(RecordedPortsTest, ShowWhatTheLoopSawCycleByCycle) {
  const SampleLease first = sample(0, 0, 1), overtaken = sample(1, 1, 2), second = sample(2, 2, 3),
                    dropped = sample(3, 4, 50), last = sample(4, 8, 5);
  show(0, PortStatus::never, {});
  end(0);
  recorder->record(0, first);
  show(1, PortStatus::fresh, first);
  command(1, 1);
  end(1);
  end(2);
  recorder->record(0, overtaken);
  recorder->record(0, second);
  show(3, PortStatus::fresh, second);
  end(3);
  recorder->record_skipped(4, 2, at(6));
  show(6, PortStatus::fresh, dropped);  // visible, and not in the file
  command(6, 2);
  end(6);
  show(7, PortStatus::overdue, dropped);
  end(7);
  end(8);
  recorder->record(0, last);
  show(9, PortStatus::fresh, last);
  end(9);
  ASSERT_TRUE(recorder->stop());

  const auto run = read_recorded_run(file);
  ASSERT_TRUE(run) << run.error().text();
  const auto rig = recorded_rig(*run, file);
  ASSERT_TRUE(rig) << rig.error().text();
  auto opened = RecordedPorts::open(file, *rig, *run);
  ASSERT_TRUE(opened) << opened.error().text();
  RecordedPorts& ports = **opened;
  const SamplePort& port = *ports.ports().inputs.at("table").port;
  struct Shown {
    std::int64_t ms;
    PortStatus status;
    std::uint64_t sequence;
    std::size_t commands;
  };
  std::vector<Shown> shown;
  while (true) {
    const auto more = ports.next();
    ASSERT_TRUE(more) << more.error().text();
    if (!*more) break;
    shown.push_back({ports.now().ns() / 1'000'000, port.status(),
                     port.sample() ? port.sample()->stamp.sequence : 99, ports.commands().size()});
  }
  const std::vector<Shown> expected{{0, PortStatus::never, 99, 0},  {1, PortStatus::fresh, 0, 1},
                                    {2, PortStatus::held, 0, 0},    {3, PortStatus::fresh, 2, 0},
                                    {6, PortStatus::fresh, 3, 1},   {7, PortStatus::overdue, 3, 0},
                                    {8, PortStatus::overdue, 3, 0}, {9, PortStatus::fresh, 4, 0}};
  ASSERT_EQ(shown.size(), expected.size());
  for (std::size_t i = 0; i < shown.size(); ++i) {
    EXPECT_EQ(shown[i].ms, expected[i].ms) << i;
    EXPECT_EQ(shown[i].status, expected[i].status) << i;
    EXPECT_EQ(shown[i].sequence, expected[i].sequence) << i;
    EXPECT_EQ(shown[i].commands, expected[i].commands) << i;
  }
  EXPECT_EQ(ports.cycles(), 8U);
  EXPECT_EQ(ports.skipped(), 2U);
  EXPECT_EQ(ports.missing_samples(), 1U);
  EXPECT_EQ(port.counters().superseded, 1U);
  EXPECT_EQ(port.counters().lost_samples, 0U);

  const auto checked = check_recorded_run(file, {});
  ASSERT_TRUE(checked) << checked.error().text();
  ASSERT_EQ(checked->expected.size(), 5U);
  for (const Expected& e : checked->expected) EXPECT_TRUE(e.holds) << e.sentence();
  EXPECT_EQ(checked->expected[1].looked_at, 4U) << "ages, that of the sample that is not there among them";
  EXPECT_EQ(checked->expected[2].looked_at, 3U) << "its value is not known";
  EXPECT_EQ(checked->expected[2].maximum, 5) << "nor taken from the sample before";
  EXPECT_EQ(checked->expected[3].looked_at, 2U);
  EXPECT_EQ(checked->missing_samples, 1U);
  EXPECT_FALSE(checked->cut_short);
}

}  // namespace
}  // namespace rigor
