// Lifecycle and registry, the worker pool, and the simulated source.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <map>
#include <vector>

#include "sensor-hal/channel/registry.h"
#include "tests/sensor-hal/channel/test_sources.h"

namespace rigor {
namespace {

using test::FormulaImages;
using test::image_config;

/// Fails where it is told to.
class Fussy final : public Source {
 public:
  SampleLease poll(BenchTime) noexcept override { return {}; }
  Status configure_result, arm_result, start_result, stop_result;

 private:
  Status do_configure(const ChannelConfig& c) override {
    description_.frame_id = c.name;
    if (c.params.flag_or("throw", false)) throw c.params.error("throw", "expected false, got true");
    return configure_result;
  }
  Status do_arm(const ArmContext&) override { return arm_result; }
  Status do_start(BenchTime) override { return start_result; }
  Status do_stop() override { return stop_result; }
};

const Status kBroken = fail(ErrorCode::io, "x", "planned");

TEST(Channel, StaysAsItWasWhenACallFails) {
  Fussy c;
  c.configure_result = kBroken;
  EXPECT_FALSE(c.configure(image_config("")));
  EXPECT_EQ(c.state(), ChannelState::created);
  EXPECT_TRUE(c.describe().frame_id.empty());
  c.configure_result = {};
  ASSERT_TRUE(c.configure(image_config("")));
  EXPECT_FALSE(c.configure(image_config("{nonsense: 1}", milliseconds(10), milliseconds(1), "other")));
  EXPECT_EQ(c.config().name, "left") << "a refused configuration left something behind";
  EXPECT_EQ(c.describe().frame_id, "left");
  c.arm_result = kBroken;
  EXPECT_FALSE(c.arm({}));
  EXPECT_EQ(c.state(), ChannelState::configured);
  c.arm_result = {};
  ASSERT_TRUE(c.arm({}));
  c.start_result = kBroken;
  EXPECT_FALSE(c.start(BenchTime(0)));
  EXPECT_EQ(c.state(), ChannelState::armed);
  c.start_result = {};
  ASSERT_TRUE(c.start(BenchTime(0)));
  c.stop_result = kBroken;
  EXPECT_FALSE(c.stop());
  EXPECT_EQ(c.state(), ChannelState::running);
  c.stop_result = {};
  EXPECT_TRUE(c.stop());
}

TEST(Channel, TurnsConfigErrorsIntoResultsWithTheirPlace) {
  Fussy c;
  const auto s = c.configure(image_config("throw: true"));
  ASSERT_FALSE(s);
  EXPECT_EQ(s.error().code, ErrorCode::bad_input);
  EXPECT_THAT(s.error().text(), testing::HasSubstr("test.yaml:1:"));
}

TEST(Registry, FindsByNameAndReplaces) {
  Registry r;
  EXPECT_EQ(r.find("modbus"), nullptr);
  const auto add = [&](const char* name, const char* summary) {
    Backend b;
    b.name = name;
    b.summary = summary;
    r.add(std::move(b));
  };
  add("modbus", "first");
  add("aravis", "cameras");
  add("modbus", "second");
  ASSERT_NE(r.find("modbus"), nullptr);
  EXPECT_EQ(r.find("modbus")->summary, "second");
  EXPECT_EQ(r.names(), (std::vector<std::string>{"aravis", "modbus"}));
}

// -------------------------------------------------------------- worker pool

TEST(WorkerPool, RunsTheJobsOfAStrandInOrderOnAnyNumberOfThreads) {
  for (std::size_t threads : {1u, 2u, 5u}) {
    WorkerPool pool(threads);
    constexpr int kStrands = 6, kJobs = 500;
    struct Line {
      std::vector<int> done;  // deliberately unprotected: ThreadSanitizer sees two threads in one strand
      std::atomic<int> next{0};
      std::unique_ptr<WorkerPool::Strand> strand;
    };
    std::vector<std::unique_ptr<Line>> lines;
    for (int i = 0; i < kStrands; ++i) {
      lines.push_back(std::make_unique<Line>());
      Line* line = lines.back().get();
      line->strand = pool.make_strand([line] { line->done.push_back(line->next++); });
      ASSERT_TRUE(line->strand);
    }
    for (int k = 0; k < kJobs; ++k)
      for (auto& line : lines) line->strand->submit();
    for (auto& line : lines) {
      line->strand->wait_idle();
      ASSERT_EQ(line->done.size(), static_cast<std::size_t>(kJobs));
      EXPECT_TRUE(std::is_sorted(line->done.begin(), line->done.end()));
      EXPECT_EQ(line->strand->backlog(), 0u);
    }
  }
}

TEST(WorkerPool, LosesNoWakeUpWhenJobsComeOneByOne) {
  WorkerPool pool(2);
  int done = 0;
  auto strand = pool.make_strand([&] { ++done; });
  for (std::uint64_t k = 1; k <= 20'000; ++k) {
    strand->submit();
    strand->wait_for(k);  // a lost wake-up hangs here
  }
  EXPECT_EQ(done, 20'000);
}

TEST(WorkerPool, DropsWhatIsNotBegunAndReusesTheStrand) {
  WorkerPool pool(1);
  std::atomic<int> done{0};
  for (std::size_t round = 0; round < 3 * WorkerPool::kMaxStrands; ++round) {
    auto strand = pool.make_strand([&] {
      std::this_thread::sleep_for(std::chrono::microseconds(20));
      ++done;
    });
    ASSERT_TRUE(strand) << round;
    for (int i = 0; i < 50; ++i) strand->submit();
    if (round == 0) strand->wait_for(1);
  }
  EXPECT_GT(done.load(), 0);
  std::vector<std::unique_ptr<WorkerPool::Strand>> all;
  for (std::size_t i = 0; i < WorkerPool::kMaxStrands; ++i) all.push_back(pool.make_strand([] {}));
  EXPECT_TRUE(all.back());
  EXPECT_FALSE(pool.make_strand([] {}));
}

// -------------------------------------------------------------- simulated source

struct Seen {
  std::uint64_t sequence;
  std::int64_t t_capture_ns;
  std::vector<std::byte> bytes;
  bool operator==(const Seen&) const = default;
};

std::vector<Seen> run_virtual(Source& source, int cycles, std::vector<SampleLease>* keep = nullptr) {
  std::vector<Seen> seen;
  for (int k = 0; k < cycles; ++k) {
    const BenchTime now = BenchTime(0) + milliseconds(k);
    source.complete_until(now);
    while (SampleLease s = source.poll(now)) {
      seen.push_back({s->stamp.sequence, s->stamp.t_capture.ns(), {s->bytes().begin(), s->bytes().end()}});
      if (keep) keep->push_back(s);
    }
    source.begin_cycle(now);
  }
  return seen;
}

TEST(SimulatedSource, GivesTheSameOnAnyNumberOfThreads) {
  std::vector<std::vector<Seen>> runs;
  for (std::size_t threads : {1u, 2u, 4u}) {
    test::TurningJoint joint;
    WorkerPool pool(threads);
    auto images = std::make_shared<FormulaImages>();
    images->delay_us = threads == 2 ? 300 : 0;  // other timing, same result
    SimulatedSource source(images, &joint, pool);
    ASSERT_TRUE(source.configure(image_config("phase_us: 2500")));
    ASSERT_TRUE(source.arm({.virtual_time = true}));
    ASSERT_TRUE(source.start(BenchTime(0)));
    auto seen = run_virtual(source, 300);
    ASSERT_TRUE(source.stop());
    // Results may be there before their release; count those that must be.
    seen.resize(28);
    EXPECT_EQ(seen[0].t_capture_ns, 2'500'000);
    EXPECT_EQ(seen[27].sequence, 27u);
    EXPECT_EQ(seen[27].t_capture_ns, 272'500'000);
    runs.push_back(std::move(seen));
  }
  EXPECT_EQ(runs[0], runs[1]);
  EXPECT_EQ(runs[0], runs[2]);
}

TEST(SimulatedSource, PassesWhatWasConfiguredToTheProvider) {
  class Spy final : public ImageProvider {
   public:
    Geometry geometry() const override { return {100, 80, PixelFormat::mono8, milliseconds(5), "spy"}; }
    Status capture(const ImageRequest& r, std::span<std::byte> pixels) override {
      last = r;
      size = pixels.size();
      return {};
    }
    ImageRequest last;
    std::size_t size = 0;
  };
  auto spy = std::make_shared<Spy>();
  test::TurningJoint joint;
  WorkerPool pool(1);
  SimulatedSource source(spy, &joint, pool);
  ASSERT_TRUE(source.configure(
      image_config("{exposure_us: 1500, gain_db: 6, pixel_format: Mono12p, region: {x_px: 10, "
                   "y_px: 20, width_px: 31, height_px: 7}}")));
  EXPECT_EQ(source.describe().max_bytes, image_bytes(PixelFormat::mono12p, 31, 7));
  ASSERT_TRUE(source.arm({.virtual_time = true}));
  ASSERT_TRUE(source.start(BenchTime(0)));
  ASSERT_FALSE(run_virtual(source, 14).empty());
  ASSERT_TRUE(source.stop());
  EXPECT_EQ(spy->last.exposure, microseconds(1500));
  EXPECT_EQ(spy->last.gain_db, 6);
  EXPECT_EQ(spy->last.format, PixelFormat::mono12p);
  EXPECT_EQ(spy->last.offset_x_px, 10u);
  EXPECT_EQ(spy->last.height_px, 7u);
  EXPECT_EQ(spy->last.motion.count, 1u);
  EXPECT_EQ(spy->size, image_bytes(PixelFormat::mono12p, 31, 7));
}

TEST(SimulatedSource, RefusesWhatDoesNotFitTheSensor) {
  WorkerPool pool(1);
  for (const char* params :
       {"region: {x_px: 60, y_px: 0, width_px: 5, height_px: 1}", "exposure_us: 0", "exposure_us: -1",
        "pixel_format: Mono14", "region: {x_px: 0, y_px: 0, width_px: 0, height_px: 1}", "phase_us: 10001",
        "slots: 0", "max_backlog: 0", "region: {x_px: 0}",
        "region: {x_px: 0, y_px: 0, width_px: 5, height_px: 1, depth_px: 1}"}) {
    SimulatedSource source(std::make_shared<FormulaImages>(), nullptr, pool);
    const auto s = source.configure(image_config(params));
    ASSERT_FALSE(s) << params;
    EXPECT_EQ(s.error().code, ErrorCode::bad_input) << params;
    EXPECT_THAT(s.error().text(), testing::HasSubstr("test.yaml:1:")) << params;
  }
  ChannelConfig registers = image_config("");
  registers.kind = SampleKind::register_block;
  SimulatedSource source(std::make_shared<FormulaImages>(), nullptr, pool);
  EXPECT_FALSE(source.configure(registers));
}

TEST(SimulatedSource, SkipsAndCountsInWallTimeWhenTheWorkerIsBehind) {
  WorkerPool pool(1);
  auto images = std::make_shared<FormulaImages>();
  images->delay_us = 5'000;
  SimulatedSource source(images, nullptr, pool);
  ASSERT_TRUE(source.configure(image_config("max_backlog: 1", milliseconds(1), milliseconds(1))));
  ASSERT_TRUE(source.arm({}));
  const BenchTime t0(monotonic_now().ns());
  ASSERT_TRUE(source.start(t0));
  std::uint64_t seen = 0, gaps = 0, lost_before = 0, next = 0;
  while (seen < 15 && bench_now() < t0 + seconds(10)) {
    const BenchTime now(monotonic_now().ns());
    source.begin_cycle(now);
    while (SampleLease s = source.poll(now)) {
      gaps += s->stamp.sequence - next;
      next = s->stamp.sequence + 1;
      lost_before += s->stamp.lost_before;
      ++seen;
    }
    std::this_thread::sleep_for(std::chrono::microseconds(500));
  }
  EXPECT_EQ(seen, 15u);
  EXPECT_GT(gaps, 2 * seen) << "five periods pass while one is rendered";
  EXPECT_EQ(gaps, lost_before) << "a gap must be said by the sample after it";
  EXPECT_GE(source.health().lost, gaps);
  EXPECT_GE(source.warm_capture(), microseconds(5'000));
  ASSERT_TRUE(source.stop());
}

TEST(SimulatedSource, WarnsWhenASampleTakesLongerThanItsLatency) {
  WorkerPool pool(1);
  auto points = std::make_shared<test::FormulaSamples>(SampleKind::point_cloud);
  points->delay_us = 20'000;
  SimulatedSource source(points, nullptr, pool);
  const auto warnings = [&](Duration latency, bool virtual_time) {
    ChannelConfig c = test::sample_config(SampleKind::point_cloud, "");
    c.latency = latency;
    EXPECT_TRUE(source.configure(c));
    EXPECT_TRUE(source.arm({.virtual_time = virtual_time}));
    auto w = source.warnings();
    EXPECT_TRUE(source.stop());
    return w;
  };
  ASSERT_EQ(warnings(milliseconds(12), false).size(), 1u);
  EXPECT_THAT(warnings(milliseconds(12), false)[0],
              testing::AllOf(testing::HasSubstr("scanner"), testing::HasSubstr("latency_ms of 12")));
  EXPECT_TRUE(warnings(seconds(100), false).empty());
  EXPECT_TRUE(warnings(milliseconds(12), true).empty()) << "virtual time waits for every sample";
}

TEST(SimulatedSource, NamesARateThatThisMachineCanKeep) {
  WorkerPool pool(1);
  auto points = std::make_shared<test::FormulaSamples>(SampleKind::point_cloud);
  points->delay_us = 20'000;
  SimulatedSource source(points, nullptr, pool);
  const auto forecasts = [&](Duration period, bool virtual_time) {
    ChannelConfig c = test::sample_config(SampleKind::point_cloud, "");
    c.name = "top.simulated";
    c.period = period;
    c.latency = seconds(100);
    EXPECT_TRUE(source.configure(c));
    EXPECT_TRUE(source.arm({.virtual_time = virtual_time}));
    EXPECT_TRUE(source.warnings().empty());
    auto w = source.forecasts();
    EXPECT_TRUE(source.stop());
    return w;
  };
  const auto slow = forecasts(milliseconds(10), false);
  ASSERT_EQ(slow.size(), 1u);
  EXPECT_TRUE(slow[0].starts_with("top: a scan takes ")) << slow[0];
  // 20 ms and what the machine adds: up to 40 Hz with a fifth to spare.
  EXPECT_THAT(slow[0], testing::HasSubstr(" ms of its 10 ms period on this machine; samples will be lost"));
  const double rate_hz = std::stod(slow[0].substr(slow[0].find("channels.top.rate_hz=") + 21));
  EXPECT_GT(rate_hz, 0);
  EXPECT_LE(rate_hz, 20);
  EXPECT_TRUE(forecasts(seconds(50), false).empty());
  EXPECT_TRUE(forecasts(milliseconds(10), true).empty()) << "virtual time waits for every sample";
}

/// Samples that need no worker.
class ImmediateSamples final : public SampleProvider {
 public:
  Geometry geometry() const override { return {SampleKind::imu, 0, 0, 0, "imu"}; }
  bool immediate() const override { return true; }
  Status capture(const Request& r, Sample& sample) override {
    measured_by = std::this_thread::get_id();
    sample.info = ImuSample{{static_cast<double>(r.index), 0, 0}, {}};
    return {};
  }
  std::thread::id measured_by;
};

TEST(SimulatedSource, MeasuresWhatIsImmediateWithoutWaitingForWorkers) {
  WorkerPool pool(1);
  std::atomic<bool> go_on{false};
  auto busy = pool.make_strand([&] {
    while (!go_on) std::this_thread::sleep_for(std::chrono::milliseconds(1));
  });
  busy->submit();  // the only worker is at a picture
  struct Release {
    std::atomic<bool>& flag;
    ~Release() { flag = true; }
  } release{go_on};
  auto imu = std::make_shared<ImmediateSamples>();
  for (const bool virtual_time : {false, true}) {
    SimulatedSource source(imu, nullptr, pool);
    ChannelConfig c = test::sample_config(SampleKind::imu, "");
    c.period = milliseconds(2);
    c.latency = milliseconds(1);
    ASSERT_TRUE(source.configure(c));
    ASSERT_TRUE(source.arm({.virtual_time = virtual_time}));
    const BenchTime t0(1'000'000'000);
    ASSERT_TRUE(source.start(t0));
    for (int i = 0; i < 100; ++i) {
      const BenchTime now = t0 + milliseconds(2) * i;
      source.begin_cycle(now);
      if (virtual_time) source.complete_until(now);
      const SampleLease sample = source.poll(now);
      ASSERT_TRUE(sample) << i;
      EXPECT_EQ(sample->stamp.sequence, static_cast<std::uint64_t>(i));
      EXPECT_EQ(sample->as<ImuSample>()->specific_force_mps2[0], i);
      EXPECT_EQ(sample->stamp.t_release, now + milliseconds(1));
    }
    EXPECT_EQ(source.health().lost, 0u);
    ASSERT_TRUE(source.stop());
  }
  EXPECT_EQ(imu->measured_by, std::this_thread::get_id());
}

TEST(SimulatedSource, TellsTheSampleProviderInstantMotionAndStart) {
  test::TurningJoint joint;
  WorkerPool pool(1);
  auto range = std::make_shared<test::FormulaSamples>(SampleKind::range_image);
  SimulatedSource source(range, &joint, pool);
  ASSERT_TRUE(source.configure(test::sample_config(SampleKind::range_image, "phase_us: 2000")));
  EXPECT_EQ(source.describe().width_px, test::FormulaSamples::kWidth);
  EXPECT_EQ(source.describe().frame_id, "tof_optical");
  ASSERT_TRUE(source.arm({.virtual_time = true}));
  ASSERT_TRUE(source.start(BenchTime(0)));
  ASSERT_FALSE(run_virtual(source, 30).empty());
  ASSERT_TRUE(source.stop());
  EXPECT_EQ(range->last.t_start, BenchTime(0));
  EXPECT_EQ((range->last.t_capture - BenchTime(0)).ns() % 10'000'000, 2'000'000);
  EXPECT_EQ(range->last.motion.count, 1u);
  ChannelConfig image = image_config("");
  EXPECT_FALSE(source.configure(image)) << "a range image is no image";
}

TEST(SimulatedSource, CountsACaptureThatFailsAndSaysSoInTheNext) {
  WorkerPool pool(1);
  auto images = std::make_shared<FormulaImages>();
  images->fail_at = 2;
  SimulatedSource source(images, nullptr, pool);
  ASSERT_TRUE(source.configure(image_config("")));
  ASSERT_TRUE(source.arm({.virtual_time = true}));
  ASSERT_TRUE(source.start(BenchTime(0)));
  std::vector<SampleLease> samples;
  run_virtual(source, 60, &samples);
  ASSERT_GE(samples.size(), 3u);
  EXPECT_EQ(samples[1]->stamp.sequence, 1u);
  EXPECT_EQ(samples[2]->stamp.sequence, 3u);
  EXPECT_EQ(samples[2]->stamp.lost_before, 1u);
  EXPECT_EQ(source.health().lost, 1u);
  samples.clear();
  ASSERT_TRUE(source.stop());
}

}  // namespace
}  // namespace rigor
