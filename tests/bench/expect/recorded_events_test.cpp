// What a recording tells of faults: typed messages alone count, and what is wrong in them is refused.
#include "bench/run/recorded_events.h"

#include <gmock/gmock.h>

#include "bench/run/recording.h"
#include "sensor-hal/channel/fault_injector.h"
#include "tests/cli/command.h"
#include "tests/cli/written_recording.h"

namespace rigor::test {
namespace {

using ::testing::HasSubstr;

class RecordedEventsTest : public ::testing::Test {
 protected:
  /// With one message of a fault of this kind, and perhaps the event that stands beside it.
  void write(std::optional<FaultKind> kind, bool event) {
    SampleSlot slot = pool_->try_acquire();
    slot->stamp = {};
    slot->info = EventInfo{.code = kEventLiveFaultBegin};
    const SampleLease lease = std::move(slot);
    RecorderOptions options;
    options.virtual_time = true;
    auto recorder = Recorder::create(file.string(), options, {}, {{"motor", {"rate"}}},
                                     {{"rigor_run", "1"},
                                      {"epoch_bench_ns", std::to_string(options.epoch.bench.ns())},
                                      {"epoch_utc_ns", std::to_string(options.epoch.utc.ns())},
                                      {"epoch_sigma_ns", "0"},
                                      {"clock", "virtual"},
                                      {"rig", "channels: {}"}});
    ASSERT_TRUE(recorder) << recorder.error().text();
    (*recorder)->begin(BenchTime(0));
    if (event) (*recorder)->record_event(~0u, lease);
    if (kind) {
      FaultChange change;
      change.fault = std::make_shared<const FaultIdentity>(
          FaultIdentity{"left.real", 3, *kind, true, R"({"kind": "drop"})", "{kind: drop}"});
      change.begins = true;
      change.t = BenchTime(7'000'000);
      (*recorder)->record_fault(change);
    }
    (*recorder)->end_cycle(7, BenchTime(7'000'000));
    ASSERT_TRUE((*recorder)->stop());
  }
  TempDir dir;
  const std::filesystem::path file = dir.path() / "run.mcap";
  std::unique_ptr<SamplePool> pool_ = make_sample_pool(2, 0);
};

TEST_F(RecordedEventsTest, FaultsAreReadFromTheirMessages) {
  write(FaultKind::drop, true);
  const auto run = read_recorded_run(file);
  ASSERT_TRUE(run) << run.error().text();
  const auto events = read_recorded_events(file, *run);
  ASSERT_TRUE(events) << events.error().text();
  ASSERT_EQ(events->faults.size(), 1u);
  const RecordedFault& f = events->faults[0];
  EXPECT_EQ(f.of, "left.real");
  EXPECT_EQ(f.index, 3u);
  EXPECT_EQ(f.kind, FaultKind::drop);
  EXPECT_TRUE(f.live && f.begins);
  EXPECT_EQ(f.t, BenchTime(7'000'000));
  EXPECT_EQ(f.json, R"({"kind": "drop"})");
  EXPECT_FALSE(events->faults_as_text);
  EXPECT_TRUE(faults_are_known(file, *events));
}

TEST_F(RecordedEventsTest, ARecordingWithFaultsAsTextAloneIsRefusedWhereTheyAreNeeded) {
  write({}, true);
  const auto run = read_recorded_run(file);
  ASSERT_TRUE(run);
  const auto events = read_recorded_events(file, *run);
  ASSERT_TRUE(events) << "whoever needs no faults can go on: " << events.error().text();
  const auto known = faults_are_known(file, *events);
  ASSERT_FALSE(known);
  EXPECT_EQ(known.error().exit_status(), 2);
  EXPECT_EQ(known.error().text(),
            file.string() +
                ": expected a recording that has its faults under /rigor/faults, got one of an "
                "earlier version, which wrote them as text alone: record the run again with this "
                "version");
}

TEST_F(RecordedEventsTest, ARecordingWithoutFaultsIsAsGoodAsAny) {
  write({}, false);
  const auto run = read_recorded_run(file);
  ASSERT_TRUE(run);
  const auto events = read_recorded_events(file, *run);
  ASSERT_TRUE(events);
  EXPECT_TRUE(faults_are_known(file, *events));
}

}  // namespace
}  // namespace rigor::test
