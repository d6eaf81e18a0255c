#include "rt-core/heartbeat.h"

#include <gtest/gtest.h>

#include <csignal>

namespace rigor {
namespace {

TEST(Heartbeat, GoesFromNotStartedToAliveToSilent) {
  Heartbeat h;
  const MonotonicTime now = monotonic_now();
  EXPECT_EQ(h.check(now, milliseconds(5)), LoopPulse::not_started);
  EXPECT_FALSE(h.expired(now + seconds(100), milliseconds(5)));
  h.beat(BenchTime(now.ns()));
  EXPECT_EQ(h.check(now + milliseconds(5), milliseconds(5)), LoopPulse::alive);
  EXPECT_EQ(h.check(now + milliseconds(6), milliseconds(5)), LoopPulse::silent);
  EXPECT_TRUE(h.expired(now + milliseconds(6), milliseconds(5)));
  h.beat(BenchTime(now.ns() + 6'000'000));
  EXPECT_EQ(h.check(now + milliseconds(7), milliseconds(5)), LoopPulse::alive);
}

TEST(Heartbeat, AStoppedLoopIsStoppedForGoodAndKeepsItsFirstReason) {
  Heartbeat h;
  h.beat(bench_now());
  h.declare_stopped(StopReason::overrun);
  h.declare_stopped(StopReason::finished);
  h.beat(bench_now());
  EXPECT_EQ(h.check(monotonic_now(), seconds(9)), LoopPulse::stopped);
  EXPECT_EQ(h.stop_reason(), StopReason::overrun);
  h.restart(false);
  EXPECT_EQ(h.check(monotonic_now(), seconds(9)), LoopPulse::not_started);
  EXPECT_EQ(h.stop_reason(), StopReason::none);
}

TEST(Heartbeat, VirtualTimeIsNeverSilent) {
  Heartbeat h;
  h.restart(true);
  h.beat(BenchTime(0));
  EXPECT_EQ(h.check(monotonic_now(), Duration(1)), LoopPulse::alive);
}

TEST(StopSource, KeepsTheFirstReason) {
  StopSource s;
  const StopToken token = s.token();
  EXPECT_FALSE(token.stop_requested());
  EXPECT_TRUE(s.request(StopReason::overrun));
  EXPECT_FALSE(s.request());
  EXPECT_EQ(token.reason(), StopReason::overrun);
  EXPECT_FALSE(StopToken().stop_requested());
}

TEST(SignalStop, ASignalRequestsAStopAndTheOldHandlerComesBack) {
  struct sigaction before {};
  sigaction(SIGTERM, nullptr, &before);
  {
    StopSource s;
    const SignalStop signals(s);
    std::raise(SIGTERM);
    EXPECT_EQ(s.reason(), StopReason::signal);
    // Sent twice at once, as by a terminal and by whoever started the process: the stop goes on.
    std::raise(SIGTERM);
  }
  struct sigaction after {};
  sigaction(SIGTERM, nullptr, &after);
  EXPECT_EQ(after.sa_handler, before.sa_handler);
}

}  // namespace
}  // namespace rigor
