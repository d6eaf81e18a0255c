// A run whose channels take longer to start than the run allowed for: begun again, with more time.
#include <gtest/gtest.h>

#include <chrono>
#include <thread>

#include "bench/run/recording.h"
#include "cli/execute.h"
#include "sensor-hal/channel/worker_pool.h"
#include "tests/cli/command.h"

namespace rigor::test {
namespace {

/// Says nothing, and is slow to start as often as it is told.
class SlowSource final : public Source {
 public:
  explicit SlowSource(int slow_starts) : slow_starts_(slow_starts) {}
  int starts = 0, stops = 0;
  BenchTime t0;
  SampleLease poll(BenchTime) noexcept override { return {}; }

 private:
  Status do_configure(const ChannelConfig& config) override {
    description_.kind = config.kind;
    return {};
  }
  Status do_arm(const ArmContext&) override { return {}; }
  Status do_start(BenchTime start) override {
    t0 = start;
    if (++starts <= slow_starts_) std::this_thread::sleep_for(std::chrono::milliseconds(1050));
    health_.connected = true;
    return {};
  }
  Status do_stop() override {
    ++stops;
    return {};
  }
  int slow_starts_;
};

struct LateStart : ::testing::Test {
  TempDir dir;
  Assembly assembly;
  SlowSource* source = nullptr;

  void make(int slow_starts) {
    write_file(dir / "rig.yaml",
               "name: slow\nduration_s: 0.05\nclock: wall\nloop: { rate_hz: 200 }\n"
               "channels:\n  slow: { kind: registers, backend: none, rate_hz: 100, latency_ms: 5 }\n"
               "record: { file: run.mcap }\n");
    auto rig = load_rig(dir / "rig.yaml", {});
    ASSERT_TRUE(rig) << rig.error().text();
    assembly.workers = std::make_unique<WorkerPool>(1);
    assembly.parts.rig = std::move(*rig);
    assembly.parts.rig.record.file = dir / "run.mcap";
    auto channel = std::make_unique<RunChannel>();
    channel->entry = &assembly.parts.rig.channels.front();
    auto made = std::make_unique<SlowSource>(slow_starts);
    source = made.get();
    ChannelConfig config;
    config.name = "slow";
    config.kind = SampleKind::register_block;
    config.period = milliseconds(10);
    ASSERT_TRUE(made->configure(config));
    channel->source = std::move(made);
    assembly.parts.channels.push_back(std::move(channel));
  }
};

TEST_F(LateStart, IsBegunAgainWithMoreTimeAndTheRecordingHasTheLaterStart) {
  make(1);
  ExecuteOptions options;
  options.json = true;
  StopSource stop;
  ASSERT_EQ(execute(assembly, options, stop.token()), 0);
  EXPECT_GE(source->starts, 2);
  EXPECT_EQ(source->stops, source->starts);
  const auto recorded = read_recorded_run(dir / "run.mcap");
  ASSERT_TRUE(recorded) << recorded.error().text();
  EXPECT_EQ(recorded->t0, source->t0);
  EXPECT_GE(recorded->cycles, 1u);
}

TEST_F(LateStart, IsGivenUpAtOnceWhenTheUserSaysSo) {
  make(100);
  StopSource stop;
  stop.request();
  ExecuteOptions options;
  options.json = true;
  EXPECT_EQ(execute(assembly, options, stop.token()), 1);
  // Before the first channel is armed.
  EXPECT_EQ(source->starts, 0);
  EXPECT_FALSE(std::filesystem::exists(dir / "run.mcap"));
}

}  // namespace
}  // namespace rigor::test
