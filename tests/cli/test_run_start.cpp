// When a run begins: as soon as all channels are armed and the loop's thread is set up, however long that
// took.
#include <gtest/gtest.h>

#include <chrono>
#include <thread>

#include "bench/run/recording.h"
#include "cli/execute.h"
#include "sensor-hal/channel/worker_pool.h"
#include "sensor-hal/record/replay_source.h"
#include "tests/cli/command.h"

namespace rigor::test {
namespace {

/// Says nothing; takes its time to arm, and, against the contract, to start.
class SlowSource final : public Source {
 public:
  SlowSource(std::chrono::milliseconds arm, std::chrono::milliseconds start)
      : arm_takes_(arm), start_takes_(start) {}
  int arms = 0, starts = 0, stops = 0;
  BenchTime armed_at, t0;
  SampleLease poll(BenchTime) noexcept override { return {}; }

 private:
  Status do_configure(const ChannelConfig& config) override {
    description_.kind = config.kind;
    return {};
  }
  Status do_arm(const ArmContext&) override {
    ++arms;
    std::this_thread::sleep_for(arm_takes_);
    armed_at = bench_now();
    health_.connected = true;
    return {};
  }
  Status do_start(BenchTime start) override {
    ++starts;
    t0 = start;
    std::this_thread::sleep_for(start_takes_);
    return {};
  }
  Status do_stop() override {
    ++stops;
    return {};
  }
  std::chrono::milliseconds arm_takes_, start_takes_;
};

/// A loop of 20 Hz for half a second.
struct RunStart : ::testing::Test {
  static constexpr std::uint64_t kCycles = 10;
  TempDir dir;
  Assembly assembly;
  SlowSource* source = nullptr;

  void make(std::chrono::milliseconds arm, std::chrono::milliseconds start) {
    write_file(dir / "rig.yaml",
               "name: slow\nduration_s: 0.5\nclock: wall\nloop: { rate_hz: 20 }\n"
               "channels:\n  slow: { kind: registers, backend: none, rate_hz: 10, latency_ms: 5 }\n"
               "record: { file: run.mcap }\n");
    auto rig = load_rig(dir / "rig.yaml", {});
    ASSERT_TRUE(rig) << rig.error().text();
    assembly.workers = std::make_unique<WorkerPool>(1);
    assembly.parts.rig = std::move(*rig);
    assembly.parts.rig.record.file = dir / "run.mcap";
    auto channel = std::make_unique<RunChannel>();
    channel->entry = &assembly.parts.rig.channels.front();
    auto made = std::make_unique<SlowSource>(arm, start);
    source = made.get();
    ChannelConfig config;
    config.name = "slow";
    config.kind = SampleKind::register_block;
    config.period = milliseconds(100);
    ASSERT_TRUE(made->configure(config));
    channel->source = std::move(made);
    assembly.parts.channels.push_back(std::move(channel));
  }
  /// Exit status of a run that tells its result in JSON.
  int run(StopToken stop = {}) {
    ExecuteOptions options;
    options.json = true;
    return execute(assembly, options, stop);
  }
  /// Whether the loop ran cycle k, by the recording.
  [[nodiscard]] std::vector<bool> cycles_run() const {
    const auto recording = Recording::open(dir / "run.mcap");
    EXPECT_TRUE(recording) << recording.error().text();
    std::vector<bool> ran;
    for (std::uint64_t k = 0; recording && k < (*recording)->cycles(); ++k)
      ran.push_back((*recording)->ran(k));
    return ran;
  }
};

TEST_F(RunStart, FollowsTheSlowestChannelAtOnceAndLosesNoCycle) {
  make(std::chrono::seconds(2), {});
  EXPECT_EQ(run(), 0);
  EXPECT_EQ(source->arms, 1);
  EXPECT_EQ(source->starts, 1);
  EXPECT_EQ(source->stops, 1);
  EXPECT_GT(source->t0, source->armed_at);
  EXPECT_LT(source->t0 - source->armed_at, milliseconds(900)) << "waited for nothing";
  EXPECT_EQ(cycles_run(), std::vector<bool>(kCycles, true));
  const auto recorded = read_recorded_run(dir / "run.mcap");
  ASSERT_TRUE(recorded) << recorded.error().text();
  EXPECT_EQ(recorded->t0, source->t0);
}

// As on a machine that is so busy that t0 has passed when the loop gets to it.
TEST_F(RunStart, ThatHasPassedSkipsCyclesAndIsNotTriedAgain) {
  make({}, std::chrono::milliseconds(220));
  EXPECT_EQ(run(), 0);
  EXPECT_EQ(source->arms, 1);
  EXPECT_EQ(source->starts, 1);
  const std::vector<bool> ran = cycles_run();
  ASSERT_EQ(ran.size(), kCycles);
  // It lay less than 100 ms ahead: 120 ms of it are over, which is two cycles and the present one.
  EXPECT_FALSE(ran[0]);
  EXPECT_FALSE(ran[1]);
  EXPECT_TRUE(ran[kCycles - 1]);
  const auto recorded = read_recorded_run(dir / "run.mcap");
  ASSERT_TRUE(recorded) << recorded.error().text();
  EXPECT_EQ(recorded->t0, source->t0);
}

TEST_F(RunStart, IsGivenUpAtOnceWhenTheUserSaysSo) {
  make(std::chrono::seconds(60), {});
  StopSource stop;
  stop.request();
  EXPECT_EQ(run(stop.token()), 1);
  EXPECT_EQ(source->arms, 0);
  EXPECT_EQ(source->starts, 0);
  EXPECT_FALSE(std::filesystem::exists(dir / "run.mcap"));
}

}  // namespace
}  // namespace rigor::test
