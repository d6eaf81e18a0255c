// When a run begins: as soon as all channels are armed and the loop's thread is set up, however long that
// took.
#include <gtest/gtest.h>

#include <chrono>
#include <thread>

#include "bench/bench.h"
#include "bench/run/recording.h"
#include "sensor-hal/record/replay_source.h"
#include "tests/cli/command.h"

namespace rigor::test {
namespace {

struct Calls {
  std::chrono::milliseconds arm{}, start{};  ///< that these take
  int arms = 0, starts = 0, stops = 0;
  BenchTime armed_at, t0;
};

/// Says nothing; takes its time to arm, and, against the contract, to start.
class SlowSource final : public Source {
 public:
  explicit SlowSource(std::shared_ptr<Calls> calls) : calls_(std::move(calls)) {}
  SampleLease poll(BenchTime) noexcept override { return {}; }

 private:
  Status do_configure(const ChannelConfig& config) override {
    description_.kind = config.kind;
    return {};
  }
  Status do_arm(const ArmContext&) override {
    ++calls_->arms;
    std::this_thread::sleep_for(calls_->arm);
    calls_->armed_at = bench_now();
    health_.connected = true;
    return {};
  }
  Status do_start(BenchTime start) override {
    ++calls_->starts;
    calls_->t0 = start;
    std::this_thread::sleep_for(calls_->start);
    return {};
  }
  Status do_stop() override {
    ++calls_->stops;
    return {};
  }
  std::shared_ptr<Calls> calls_;
};

/// A loop of 20 Hz for half a second.
struct RunStart : ::testing::Test {
  static constexpr std::uint64_t kCycles = 10;
  TempDir dir;
  std::shared_ptr<Calls> source = std::make_shared<Calls>();
  std::unique_ptr<Bench> bench;

  void make(std::chrono::milliseconds arm, std::chrono::milliseconds start) {
    source->arm = arm;
    source->start = start;
    write_file(dir / "rig.yaml",
               "name: slow\nduration_s: 0.5\nclock: wall\nloop: { rate_hz: 20 }\n"
               "channels:\n  slow: { kind: registers, backend: slow, rate_hz: 10, latency_ms: 5 }\n");
    auto rig = load_rig(dir / "rig.yaml", {});
    ASSERT_TRUE(rig) << rig.error().text();
    rig->record.file = dir / "run.mcap";
    Registry registry;
    Backend backend;
    backend.name = "slow";
    backend.make_source = [this] { return std::make_unique<SlowSource>(source); };
    registry.add(std::move(backend));
    auto made = Bench::create(std::move(*rig), registry);
    ASSERT_TRUE(made) << made.error().text();
    bench = std::move(*made);
  }
  /// Whether it passed.
  bool run(StopToken stop = {}) {
    if (!bench->prepare(stop)) return false;
    const auto report = bench->run(stop);
    return report && report->passed();
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
  EXPECT_TRUE(run());
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
  EXPECT_TRUE(run());
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
  EXPECT_FALSE(run(stop.token()));
  EXPECT_EQ(source->arms, 0);
  EXPECT_EQ(source->starts, 0);
  EXPECT_FALSE(std::filesystem::exists(dir / "run.mcap"));
}

}  // namespace
}  // namespace rigor::test
