// What every sink and every emulator has to do: their lifecycle, and for sinks what happens to the device
// while nobody commands it.
//
//   class MyEmulator : public ChannelUnderTest { … make(), config(), … };
//   INSTANTIATE_TEST_SUITE_P(Mine, LifecycleConformance,
//                            testing::Values(channel_under_test<MyEmulator>("mine")), name_of_channel_case);
#pragma once

#include <gmock/gmock.h>

#include <chrono>
#include <functional>
#include <memory>
#include <string>
#include <thread>

#include "rt-core/heartbeat.h"
#include "sensor-hal/channel/emulator.h"
#include "sensor-hal/conformance/call_rules.h"

namespace rigor::conformance {

/// A sink or an emulator with all it needs.
class ChannelUnderTest {
 public:
  virtual ~ChannelUnderTest() = default;
  /// Created and attached, as arm needs it.
  [[nodiscard]] virtual std::unique_ptr<Channel> make() = 0;
  [[nodiscard]] virtual ChannelConfig config() = 0;
  [[nodiscard]] virtual ChannelConfig config_with_unknown_key() = 0;
  [[nodiscard]] virtual bool virtual_time() const { return false; }
  [[nodiscard]] virtual std::string unavailable() { return {}; }
};
struct ChannelCase {
  std::string name;
  std::function<std::unique_ptr<ChannelUnderTest>()> make;
};
template <class T>
[[nodiscard]] ChannelCase channel_under_test(std::string name) {
  return {std::move(name), [] { return std::make_unique<T>(); }};
}
inline std::string name_of_channel_case(const testing::TestParamInfo<ChannelCase>& info) {
  return info.param.name;
}
inline std::ostream& operator<<(std::ostream& out, const ChannelCase& c) { return out << c.name; }

class LifecycleConformance : public testing::TestWithParam<ChannelCase> {
 protected:
  void SetUp() override {
    backend_ = GetParam().make();
    if (const auto why = backend_->unavailable(); !why.empty()) GTEST_SKIP() << why;
    channel_ = backend_->make();
    ASSERT_NE(channel_, nullptr);
    context_.virtual_time = backend_->virtual_time();
    t0_ = context_.virtual_time ? BenchTime(0) : bench_now() + milliseconds(100);
  }
  void TearDown() override {
    channel_.reset();
    backend_.reset();
  }
  std::unique_ptr<ChannelUnderTest> backend_;
  std::unique_ptr<Channel> channel_;
  ArmContext context_;
  BenchTime t0_;
};

TEST_P(LifecycleConformance, RefusesWhatItsStateDoesNotAllow) {
  expect_wrong_state(channel_->arm(context_), "arm of a created channel");
  expect_wrong_state(channel_->start(BenchTime(0)), "start of a created channel");
  expect_wrong_state(channel_->stop(), "stop of a created channel");
  auto s = channel_->configure(backend_->config());
  ASSERT_TRUE(s) << s.error().text();
  expect_wrong_state(channel_->start(BenchTime(0)), "start of a configured channel");
  expect_wrong_state(channel_->stop(), "stop of a configured channel");
  s = channel_->arm(context_);
  ASSERT_TRUE(s) << s.error().text();
  expect_wrong_state(channel_->configure(backend_->config()), "configure of an armed channel");
  expect_wrong_state(channel_->arm(context_), "arm of an armed channel");
  s = channel_->start(t0_);
  ASSERT_TRUE(s) << s.error().text();
  expect_wrong_state(channel_->configure(backend_->config()), "configure of a running channel");
  expect_wrong_state(channel_->arm(context_), "arm of a running channel");
  expect_wrong_state(channel_->start(t0_), "start of a running channel");
  s = channel_->stop();
  ASSERT_TRUE(s) << s.error().text();
  EXPECT_EQ(channel_->state(), ChannelState::configured);
}

TEST_P(LifecycleConformance, RunsAgainAfterStopAndCanBeDisarmed) {
  ASSERT_TRUE(channel_->configure(backend_->config()));
  for (int round = 0; round < 3; ++round) {
    auto s = channel_->arm(context_);
    ASSERT_TRUE(s) << s.error().text();
    if (round != 1) {
      s = channel_->start(t0_);
      ASSERT_TRUE(s) << s.error().text();
    }
    s = channel_->stop();
    ASSERT_TRUE(s) << s.error().text();
  }
  // Destroyed while running: nothing hangs, no thread stays (the sanitizers would tell).
  ASSERT_TRUE(channel_->arm(context_));
  ASSERT_TRUE(channel_->start(t0_));
  channel_.reset();
}

TEST_P(LifecycleConformance, RefusesUnknownKeysAndStaysAsItWas) {
  const auto s = channel_->configure(backend_->config_with_unknown_key());
  ASSERT_FALSE(s);
  EXPECT_EQ(s.error().code, ErrorCode::bad_input);
  EXPECT_THAT(s.error().text(), testing::HasSubstr("no_such_key"));
  EXPECT_EQ(channel_->state(), ChannelState::created);
  EXPECT_TRUE(channel_->configure(backend_->config()));
}
GTEST_ALLOW_UNINSTANTIATED_PARAMETERIZED_TEST(LifecycleConformance);

/// Sinks in wall time, in addition: between arm and start nobody commands, and the device is safe.
class SinkConformance : public LifecycleConformance {
 protected:
  void SetUp() override {
    LifecycleConformance::SetUp();
    if (IsSkipped()) return;
    sink_ = dynamic_cast<Sink*>(channel_.get());
    ASSERT_NE(sink_, nullptr);
    heartbeat_.restart(false);
    sink_->watch(&heartbeat_, milliseconds(100));
    const auto s = sink_->configure(backend_->config());
    ASSERT_TRUE(s) << s.error().text();
  }
  void arm() {
    const auto s = sink_->arm(context_);
    ASSERT_TRUE(s) << s.error().text();
  }
  /// For at most ten seconds; the loop beats meanwhile or is as it was.
  bool eventually(bool beats, const std::function<bool()>& holds) {
    const BenchTime until = bench_now() + seconds(10);
    while (!holds() && bench_now() < until) {
      if (beats) heartbeat_.beat(bench_now());
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
    return holds();
  }
  Heartbeat heartbeat_;
  Sink* sink_ = nullptr;
};

TEST_P(SinkConformance, JudgesTheLoopOnlyOnceTheRunHasBegun) {
  heartbeat_.declare_stopped(StopReason::requested);  // of the run before
  arm();
  std::this_thread::sleep_for(std::chrono::milliseconds(300));
  EXPECT_EQ(sink_->counters().made_safe, 0u);
  EXPECT_TRUE(sink_->health().connected);
  ASSERT_TRUE(sink_->start(bench_now()));
  EXPECT_TRUE(eventually(false, [&] { return sink_->counters().made_safe == 1; }))
      << "the loop has stopped, and nobody made the device safe";
  ASSERT_TRUE(sink_->stop());
}

TEST_P(SinkConformance, AppliesCommandsHoweverLongItWaitedForTheRun) {
  CallCost cost;
  for (int round = 0; round < 3; ++round) {
    arm();
    std::this_thread::sleep_for(std::chrono::milliseconds(round == 0 ? 300 : 5));
    const std::uint64_t applied = sink_->counters().applied;
    const CallCost before = CallCost::now();
    const auto s = sink_->start(bench_now() + milliseconds(20));
    cost.keep_least(before, CallCost::now());
    ASSERT_TRUE(s) << s.error().text();
    heartbeat_.beat(bench_now());
    Command c;
    c.t_issue = bench_now() + milliseconds(20);
    c.t_effect = c.t_issue + milliseconds(5);
    c.count = static_cast<std::uint32_t>(sink_->describe().names.size());
    ASSERT_TRUE(sink_->command(c));
    EXPECT_TRUE(eventually(true, [&] { return sink_->counters().applied == applied + 1; }));
    EXPECT_EQ(sink_->counters().made_safe, 0u);
    ASSERT_TRUE(sink_->stop());
  }
  EXPECT_EQ(cost.waits, 0) << "start() blocks; the loop calls it on its own thread";
  EXPECT_EQ(cost.threads, 0) << "start() creates threads";
}
GTEST_ALLOW_UNINSTANTIATED_PARAMETERIZED_TEST(SinkConformance);

}  // namespace rigor::conformance
