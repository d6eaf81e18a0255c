// What every source has to do, whatever is behind it: one suite that a device, an emulated device, a
// simulator, a recording and a pair are run through.
//
//   class MySource : public SourceUnderTest { … make(), config(), … };
//   INSTANTIATE_TEST_SUITE_P(Mine, SourceConformance, testing::Values(under_test<MySource>("mine")),
//   name_of_case);
//
// A source passes in virtual time, in wall time, or in both: `virtual_time()` says how this case makes time
// pass.
#pragma once

#include <gmock/gmock.h>
#include <time.h>

#include <cstring>
#include <functional>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "sensor-hal/conformance/call_rules.h"

namespace rigor::conformance {

/// A backend and all it needs to run. Made anew for each test.
class SourceUnderTest {
 public:
  virtual ~SourceUnderTest() = default;
  /// A source in state created. What it points to lives as long as this object.
  [[nodiscard]] virtual std::unique_ptr<Source> make() = 0;
  [[nodiscard]] virtual ChannelConfig config() = 0;
  /// The same, with a key that no backend has.
  [[nodiscard]] virtual ChannelConfig config_with_unknown_key() = 0;
  [[nodiscard]] virtual bool virtual_time() const { return true; }
  /// The bench time of the first cycle, where it matters (replay).
  [[nodiscard]] virtual BenchTime virtual_t0() const { return BenchTime(0); }
  /// Slots of the sample pool; 0: not known, then exhaustion is not provoked.
  [[nodiscard]] virtual std::size_t slots() const { return 0; }
  /// How long after start the first sample may be released, beside its latency.
  [[nodiscard]] virtual Duration settle() const { return milliseconds(0); }
  /// False of a pair, which keeps leases of what it gave. Any other source lets a stage behind it take back
  /// the slot (Source::poll).
  [[nodiscard]] virtual bool gives_only_lease() const { return true; }
  /// Empty, or why this case cannot run here: the test is then reported as skipped.
  [[nodiscard]] virtual std::string unavailable() { return {}; }
};

struct SourceCase {
  std::string name;
  std::function<std::unique_ptr<SourceUnderTest>()> make;
};
template <class T>
[[nodiscard]] SourceCase under_test(std::string name) {
  return {std::move(name), [] { return std::make_unique<T>(); }};
}
inline std::string name_of_case(const testing::TestParamInfo<SourceCase>& info) { return info.param.name; }
inline std::ostream& operator<<(std::ostream& out, const SourceCase& c) { return out << c.name; }

class SourceConformance : public testing::TestWithParam<SourceCase> {
 protected:
  static constexpr Duration kCycle = milliseconds(1);

  void SetUp() override {
    backend_ = GetParam().make();
    if (const auto why = backend_->unavailable(); !why.empty()) GTEST_SKIP() << why;
    source_ = backend_->make();
    ASSERT_NE(source_, nullptr);
    config_ = backend_->config();
  }
  void TearDown() override {
    held_.clear();
    source_.reset();
    backend_.reset();
  }

  void configure() {
    const auto s = source_->configure(config_);
    ASSERT_TRUE(s) << s.error().text();
  }
  void arm() {
    ArmContext context;
    context.virtual_time = backend_->virtual_time();
    context.loop_period = kCycle;
    const auto s = source_->arm(context);
    ASSERT_TRUE(s) << s.error().text();
  }
  /// Starts what is armed; the first cycle is the next.
  void begin() {
    t0_ = backend_->virtual_time() ? backend_->virtual_t0() : bench_now() + milliseconds(50);
    const CallCost before = CallCost::now();
    const auto s = source_->start(t0_);
    start_cost_.keep_least(before, CallCost::now());
    ASSERT_TRUE(s) << s.error().text();
    cycle_ = 0;
  }
  void start() {
    arm();
    if (!HasFatalFailure()) begin();
  }
  void stop() {
    const auto s = source_->stop();
    ASSERT_TRUE(s) << s.error().text();
  }
  /// Runs cycles until `until` says so or time is over; each sample is given to `see`.
  template <class See>
  void run(Duration at_most, See&& see, const std::function<bool()>& until = {}) {
    const std::int64_t end = cycle_ + at_most / kCycle;
    for (; cycle_ < end && !(until && until()); ++cycle_) {
      const BenchTime now = t0_ + kCycle * cycle_;
      if (backend_->virtual_time()) {
        source_->complete_until(now);
      } else {
        const timespec t{now.ns() / 1'000'000'000, now.ns() % 1'000'000'000};
        while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, nullptr) == EINTR) {
        }
      }
      while (true) {
        const auto before = monotonic_now();
        SampleLease sample = source_->poll(now);
        poll_ns_.push_back((monotonic_now() - before).ns());
        if (!sample) break;
        ++delivered_;
        see(sample, now);
      }
      source_->begin_cycle(now);
    }
  }
  [[nodiscard]] Duration period() const {
    return config_.period.ns() > 0 ? Duration(config_.period) : milliseconds(10);
  }
  /// Time in which `n` samples must have come.
  [[nodiscard]] Duration time_for(int n) const {
    const Duration slack = backend_->virtual_time() ? milliseconds(2) : seconds(2);
    return backend_->settle() + config_.latency + period() * n + slack;
  }
  /// Runs cycles until the first sample has come, then for `n` periods, then until `enough` holds, but for no
  /// longer than time_for(n) in all. The caller judges what came then.
  template <class See>
  void run_periods(int n, See&& see, const std::function<bool()>& enough) {
    const std::int64_t end = cycle_ + time_for(n) / kCycle;
    const auto left = [&] { return kCycle * (end - cycle_); };
    run(left(), see, [&] { return delivered_ > 0; });
    run(std::min(left(), period() * n), see);
    run(left(), see, enough);
  }
  std::vector<SampleLease> collect(int n) {
    std::vector<SampleLease> samples;
    run(
        time_for(n), [&](const SampleLease& s, BenchTime) { samples.push_back(s); },
        [&] { return samples.size() >= static_cast<std::size_t>(n); });
    return samples;
  }
  [[nodiscard]] int few() const {
    const std::size_t slots = backend_->slots();
    return slots == 0 ? 3 : static_cast<int>(std::min<std::size_t>(4, slots - 1));
  }

  std::unique_ptr<SourceUnderTest> backend_;
  std::unique_ptr<Source> source_;
  ChannelConfig config_;
  BenchTime t0_;
  std::int64_t cycle_ = 0;
  std::uint64_t delivered_ = 0;
  std::vector<std::int64_t> poll_ns_;
  CallCost start_cost_;
  std::vector<SampleLease> held_;
};

TEST_P(SourceConformance, RefusesWhatItsStateDoesNotAllow) {
  ArmContext context;
  context.virtual_time = backend_->virtual_time();
  expect_wrong_state(source_->arm(context), "arm of a created channel");
  expect_wrong_state(source_->start(BenchTime(0)), "start of a created channel");
  expect_wrong_state(source_->stop(), "stop of a created channel");
  configure();
  EXPECT_EQ(source_->state(), ChannelState::configured);
  expect_wrong_state(source_->start(BenchTime(0)), "start of a configured channel");
  expect_wrong_state(source_->stop(), "stop of a configured channel");
  start();
  EXPECT_EQ(source_->state(), ChannelState::running);
  expect_wrong_state(source_->configure(config_), "configure of a running channel");
  expect_wrong_state(source_->arm(context), "arm of a running channel");
  expect_wrong_state(source_->start(t0_), "start of a running channel");
  EXPECT_EQ(source_->state(), ChannelState::running);
  stop();
  EXPECT_EQ(source_->state(), ChannelState::configured);
}

TEST_P(SourceConformance, CanBeDisarmedWithoutHavingRun) {
  configure();
  ArmContext context;
  context.virtual_time = backend_->virtual_time();
  ASSERT_TRUE(source_->arm(context));
  expect_wrong_state(source_->arm(context), "arm of an armed channel");
  expect_wrong_state(source_->configure(config_), "configure of an armed channel");
  EXPECT_FALSE(source_->poll(BenchTime(0)));
  stop();
  EXPECT_EQ(source_->state(), ChannelState::configured);
  start();
  EXPECT_FALSE(collect(1).empty());
  stop();
}

// Other channels may take long to arm. What a device measures meanwhile is not of the run.
TEST_P(SourceConformance, WaitsForTheRunToBeginForAsLongAsItTakes) {
  configure();
  for (int round = 0; round < 3; ++round) {
    const auto counted = [&] {
      const HealthSnapshot h = source_->health();
      return std::vector<std::uint64_t>{h.received, h.incomplete, h.lost, h.no_slot, h.ring_full};
    };
    const auto before = counted();
    arm();
    if (!backend_->virtual_time())
      std::this_thread::sleep_for(std::chrono::milliseconds(round == 0 ? 300 : 20));
    EXPECT_FALSE(source_->poll(BenchTime::never())) << "handed over before the run";
    EXPECT_EQ(counted(), before) << "received, incomplete, lost, no slot, ring full";
    begin();
    const auto samples = collect(few());
    ASSERT_GE(samples.size(), static_cast<std::size_t>(few()));
    for (const SampleLease& s : samples) {
      const Stamp& stamp = s->stamp;
      EXPECT_GE(stamp.t_capture, t0_ - config_.period / 2) << "of before the run";
      // No further than the grid of t0; by one where the device is out of phase with it.
      if (config_.period.ns() > 0) {
        EXPECT_LE(static_cast<std::int64_t>(stamp.sequence),
                  config_.period.nearest_index(stamp.t_capture - t0_) + 1);
      }
    }
    if (config_.period.ns() <= 0) {
      EXPECT_EQ(samples.front()->stamp.sequence, 0u);
    }
    stop();
  }
  if (backend_->virtual_time()) return;
  EXPECT_EQ(start_cost_.waits, 0) << "start() blocks; the loop calls it on its own thread";
  EXPECT_EQ(start_cost_.threads, 0) << "start() creates threads";
}

TEST_P(SourceConformance, RefusesUnknownKeysAndStaysAsItWas) {
  const auto s = source_->configure(backend_->config_with_unknown_key());
  ASSERT_FALSE(s);
  EXPECT_EQ(s.error().code, ErrorCode::bad_input);
  EXPECT_THAT(s.error().text(), testing::HasSubstr("no_such_key"));
  EXPECT_EQ(source_->state(), ChannelState::created);
  configure();
}

TEST_P(SourceConformance, GivesWhatItDescribes) {
  configure();
  const ChannelDescription description = source_->describe();
  EXPECT_EQ(description.kind, config_.kind);
  start();
  const auto samples = collect(few());
  ASSERT_GE(samples.size(), static_cast<std::size_t>(few()));
  const ChannelDescription& armed = source_->describe();
  for (const SampleLease& s : samples) {
    EXPECT_EQ(s->kind(), armed.kind);
    EXPECT_LE(s->size_bytes, armed.max_bytes);
    if (const auto* image = s->as<ImageInfo>()) {
      EXPECT_EQ(image->width_px, armed.width_px);
      EXPECT_EQ(image->height_px, armed.height_px);
      EXPECT_EQ(image->format, armed.format);
      EXPECT_EQ(s->size_bytes, image_bytes(image->format, image->width_px, image->height_px));
    } else if (const auto* range = s->as<RangeImageInfo>()) {
      EXPECT_EQ(range->width_px, armed.width_px);
      EXPECT_EQ(range->height_px, armed.height_px);
      const std::size_t plane = std::size_t{range->width_px} * range->height_px * sizeof(float);
      EXPECT_TRUE(s->size_bytes == plane || s->size_bytes == 2 * plane) << s->size_bytes;
    } else if (const auto* cloud = s->as<PointCloudInfo>()) {
      EXPECT_EQ(s->size_bytes, cloud->count * sizeof(LidarPoint));
    } else if (const auto* block = s->as<RegisterBlock>()) {
      EXPECT_EQ(block->count, armed.names.size());
      EXPECT_EQ(armed.units.size(), armed.names.size());
    }
  }
  stop();
}

TEST_P(SourceConformance, KeepsLeasesOfWhatItGaveOnlyIfItSaysSo) {
  configure();
  start();
  int given = 0, shared = 0;
  run(
      time_for(few()),
      [&](SampleLease& s, BenchTime) {
        ++given;
        shared += !s.take_back();
      },
      [&] { return given >= few(); });
  EXPECT_GE(given, few());
  EXPECT_EQ(shared > 0, !backend_->gives_only_lease())
      << "the source keeps leases of " << shared << " samples of " << given;
  stop();
}

TEST_P(SourceConformance, KeepsTheOrderOfSequenceAndTime) {
  configure();
  start();
  const int wanted = 12;
  int seen = 0;
  bool any = false;
  Stamp last;
  run(
      time_for(wanted),
      [&](const SampleLease& s, BenchTime) {
        const Stamp& stamp = s->stamp;
        EXPECT_EQ(stamp.t_release - stamp.t_capture, config_.latency);
        if (backend_->virtual_time()) {
          EXPECT_EQ(stamp.t_arrival, stamp.t_release);
        } else {
          // Stamped on the way, polled afterwards; a device clock that is still being mapped may be off a
          // little.
          EXPECT_LE(stamp.t_arrival, bench_now());
          EXPECT_GE(stamp.t_arrival, stamp.t_capture - milliseconds(5));
        }
        if (any) {
          EXPECT_GT(stamp.sequence, last.sequence);
          EXPECT_GE(stamp.t_release, last.t_release);
          EXPECT_GT(stamp.t_capture, last.t_capture);
        }
        EXPECT_GE(stamp.sigma_capture, Duration(0));
        last = stamp;
        any = true;
        ++seen;
      },
      [&] { return seen >= wanted; });
  EXPECT_GE(seen, wanted);
  stop();
}

TEST_P(SourceConformance, RunsAgainAfterStop) {
  configure();
  for (int round = 0; round < 3; ++round) {
    start();
    EXPECT_GE(collect(few()).size(), static_cast<std::size_t>(few())) << "round " << round;
    stop();
    EXPECT_FALSE(source_->health().connected);
    EXPECT_FALSE(source_->poll(t0_ + seconds(100))) << "a stopped channel gave a sample";
  }
  configure();  // and can be configured anew
  start();
  EXPECT_FALSE(collect(1).empty());
  stop();
}

TEST_P(SourceConformance, StopsWhileSamplesAreHeldAndPending) {
  configure();
  start();
  held_ = collect(few());
  ASSERT_FALSE(held_.empty());
  run(config_.period * 2, [](const SampleLease&, BenchTime) {});
  std::vector<std::vector<std::byte>> copies;
  for (const auto& s : held_) copies.emplace_back(s->bytes().begin(), s->bytes().end());
  stop();
  // What is held stays what it was, also while the next run fills slots.
  start();
  EXPECT_FALSE(collect(1).empty());
  const auto expect_as_they_were = [&] {
    for (std::size_t i = 0; i < held_.size(); ++i)
      EXPECT_TRUE(
          std::equal(copies[i].begin(), copies[i].end(), held_[i]->bytes().begin(), held_[i]->bytes().end()))
          << "held sample " << i << " was written over";
  };
  expect_as_they_were();
  stop();
  source_.reset();  // and when there is no source any more
  expect_as_they_were();
}

TEST_P(SourceConformance, CountsWhatFindsNoSlotAndGoesOn) {
  const std::size_t slots = backend_->slots();
  if (slots == 0) GTEST_SKIP() << "the size of this backend's pool is not known to the test";
  configure();
  start();
  const auto counted = [&] {
    const HealthSnapshot h = source_->health();
    return h.no_slot + h.lost + h.ring_full;
  };
  run_periods(
      static_cast<int>(slots) + 4, [&](const SampleLease& s, BenchTime) { held_.push_back(s); },
      [&] { return held_.size() + 2 >= slots && counted() > 0; });
  EXPECT_LE(held_.size(), slots);
  EXPECT_GE(held_.size() + 2, slots) << "slots cannot be used up";
  EXPECT_GT(counted(), 0u) << "samples vanished without a count";
  held_.clear();
  EXPECT_FALSE(collect(1).empty()) << "the channel did not recover when its slots were given back";
  stop();
}

TEST_P(SourceConformance, CountsWhatItGave) {
  configure();
  const auto received_before = source_->health().received;
  start();
  // At an instant when nothing is on its way the counts agree exactly. A source that counts too much or loses
  // samples has no such instant, and what it does adds up until the time is over.
  const auto agree = [&] {
    const HealthSnapshot h = source_->health();
    return delivered_ >= 8 && h.received - received_before == delivered_ + h.ring_full;
  };
  run_periods(
      8, [](const SampleLease&, BenchTime) {}, agree);
  const HealthSnapshot h = source_->health();
  EXPECT_TRUE(h.connected);
  const std::uint64_t received = h.received - received_before;
  EXPECT_GT(delivered_, 0u);
  EXPECT_GE(received, delivered_);
  // The rest is on its way: not released yet, or read ahead.
  const std::uint64_t pending_at_most =
      config_.period.ns() > 0 ? static_cast<std::uint64_t>(config_.latency / config_.period) + 3 : 16;
  EXPECT_LE(received, delivered_ + h.ring_full + std::max<std::uint64_t>(pending_at_most, backend_->slots()));
  stop();
}

TEST_P(SourceConformance, NeverBlocksInPoll) {
  configure();
  start();
  run_periods(
      10, [](const SampleLease&, BenchTime) {}, [&] { return delivered_ >= 10 && poll_ns_.size() > 100; });
  ASSERT_GT(poll_ns_.size(), 20u);
  std::sort(poll_ns_.begin(), poll_ns_.end());
  // A machine that is busy with something else preempts us now and then; a poll that waits does so always.
  EXPECT_LT(poll_ns_[poll_ns_.size() / 2], 100'000) << "ns, median of " << poll_ns_.size() << " polls";
  stop();
}
GTEST_ALLOW_UNINSTANTIATED_PARAMETERIZED_TEST(SourceConformance);

}  // namespace rigor::conformance
