// A run whose channels take longer to start than the run allowed for: begun again, with more time.
#include <gtest/gtest.h>

#include <chrono>
#include <thread>

#include "bench/bench.h"
#include "bench/run/recording.h"
#include "tests/cli/command.h"

namespace rigor::test {
namespace {

struct Starts {
  int slow = 0;  ///< starts that take their time
  int starts = 0, stops = 0;
  BenchTime t0;
};

/// Says nothing, and is slow to start as often as it is told.
class SlowSource final : public Source {
 public:
  explicit SlowSource(std::shared_ptr<Starts> starts) : starts_(std::move(starts)) {}
  SampleLease poll(BenchTime) noexcept override { return {}; }

 private:
  Status do_configure(const ChannelConfig& config) override {
    description_.kind = config.kind;
    return {};
  }
  Status do_arm(const ArmContext&) override { return {}; }
  Status do_start(BenchTime start) override {
    starts_->t0 = start;
    if (++starts_->starts <= starts_->slow) std::this_thread::sleep_for(std::chrono::milliseconds(1050));
    health_.connected = true;
    return {};
  }
  Status do_stop() override {
    ++starts_->stops;
    return {};
  }
  std::shared_ptr<Starts> starts_;
};

struct LateStart : ::testing::Test {
  TempDir dir;
  std::shared_ptr<Starts> starts = std::make_shared<Starts>();

  std::unique_ptr<Bench> make(int slow_starts) {
    starts->slow = slow_starts;
    write_file(dir / "rig.yaml",
               "name: slow\nduration_s: 0.05\nclock: wall\nloop: { rate_hz: 200 }\n"
               "channels:\n  slow: { kind: registers, backend: slow, rate_hz: 100, latency_ms: 5 }\n"
               "record: { file: run.mcap }\n");
    auto rig = load_rig(dir / "rig.yaml", {});
    EXPECT_TRUE(rig) << rig.error().text();
    rig->record.file = dir / "run.mcap";
    Registry registry;
    Backend backend;
    backend.name = "slow";
    backend.make_source = [this] { return std::make_unique<SlowSource>(starts); };
    registry.add(std::move(backend));
    auto bench = Bench::create(std::move(*rig), registry);
    EXPECT_TRUE(bench) << bench.error().text();
    return bench ? std::move(*bench) : nullptr;
  }
};

TEST_F(LateStart, IsBegunAgainWithMoreTimeAndTheRecordingHasTheLaterStart) {
  const auto bench = make(1);
  ASSERT_TRUE(bench && bench->prepare());
  const auto report = bench->run();
  ASSERT_TRUE(report) << report.error().text();
  EXPECT_TRUE(report->passed()) << report->text;
  EXPECT_GE(starts->starts, 2);
  EXPECT_EQ(starts->stops, starts->starts);
  const auto recorded = read_recorded_run(dir / "run.mcap");
  ASSERT_TRUE(recorded) << recorded.error().text();
  EXPECT_EQ(recorded->t0, starts->t0);
  EXPECT_GE(recorded->cycles, 1u);
}

TEST_F(LateStart, IsGivenUpAtOnceWhenTheUserSaysSo) {
  const auto bench = make(100);
  StopSource stop;
  stop.request();
  ASSERT_TRUE(bench);
  const Status prepared = bench->prepare(stop.token());
  ASSERT_FALSE(prepared);
  EXPECT_EQ(prepared.error().code, ErrorCode::unavailable);
  EXPECT_EQ(starts->starts, 0);
  EXPECT_FALSE(std::filesystem::exists(dir / "run.mcap"));
}

}  // namespace
}  // namespace rigor::test
