#include "rt-core/realtime_setup.h"
#include "rt-core/affinity.h"
#include "rt-core/sanitizers.h"
#include "rt-core/time_slice.h"

#include <gtest/gtest.h>
#include <sched.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>
#include <cstdint>
#include <fstream>
#include <thread>

namespace rigor {
namespace {

const RealtimeSetting* find(const std::vector<RealtimeSetting>& settings, const std::string& name) {
  const auto it =
      std::find_if(settings.begin(), settings.end(), [&](const auto& s) { return s.name == name; });
  return it == settings.end() ? nullptr : &*it;
}

long locked_kib() {
  std::ifstream status("/proc/self/status");
  for (std::string line; std::getline(status, line);)
    if (line.rfind("VmLck:", 0) == 0) return std::stol(line.substr(6));
  return -1;
}

struct Scheduling {
  std::uint32_t size, policy;
  std::uint64_t flags;
  std::int32_t nice;
  std::uint32_t priority;
  std::uint64_t slice_ns, deadline_ns, period_ns;
};

Scheduling scheduling_of_this_thread() {
  Scheduling s{};
  EXPECT_EQ(syscall(SYS_sched_getattr, 0, &s, sizeof s, 0U), 0);
  return s;
}

TEST(TimeSlice, IsTheThreadsOwnAndChangesNothingElse) {
  std::thread([] {
    const auto before = scheduling_of_this_thread();
    for (const Duration slice : {kLongTimeSlice, kShortTimeSlice}) {
      ask_for_time_slice(slice);
      const auto after = scheduling_of_this_thread();
      // Kernels before 6.12 say 0 and have no slices of threads.
      const auto expected = before.slice_ns == 0 ? 0 : static_cast<std::uint64_t>(slice.ns());
      EXPECT_EQ(after.slice_ns, expected);
      EXPECT_EQ(after.policy, before.policy);
      EXPECT_EQ(after.nice, before.nice);
    }
  }).join();
}

TEST(RealtimeSetup, WhatItSaysIsWhatTheKernelSays) {
  std::thread([] {
    const int policy_before = sched_getscheduler(0);
    RealtimeSetup setup;
    RealtimeConfig config;
    config.fifo_priority = 42;
    setup.prepare_process(config);
    setup.prepare_thread(config);
    for (const RealtimeSetting& s : setup.settings()) EXPECT_FALSE(s.text.empty()) << s.name;

    const RealtimeSetting* fifo = find(setup.settings(), "SCHED_FIFO");
    ASSERT_TRUE(fifo && fifo->wanted);
    sched_param p{};
    sched_getparam(0, &p);
    EXPECT_EQ(fifo->granted,
              (sched_getscheduler(0) & ~SCHED_RESET_ON_FORK) == SCHED_FIFO && p.sched_priority == 42);

    const RealtimeSetting* affinity = find(setup.settings(), "CPU affinity");
    ASSERT_TRUE(affinity);
    cpu_set_t set;
    sched_getaffinity(0, sizeof set, &set);
    EXPECT_TRUE(!affinity->granted || CPU_COUNT(&set) == 1);

    const RealtimeSetting* lock = find(setup.settings(), "memory lock");
    ASSERT_TRUE(lock && lock->wanted);
#if !defined(RIGOR_ADDRESS_SANITIZER) && !defined(RIGOR_THREAD_SANITIZER)  // these make mlockall do nothing
    EXPECT_EQ(lock->granted, locked_kib() > 0);
#endif

    setup.restore_thread();
    setup.restore_process();
    EXPECT_EQ(sched_getscheduler(0) & ~SCHED_RESET_ON_FORK, policy_before);
    EXPECT_EQ(locked_kib(), 0);
  }).join();
}

TEST(RealtimeSetup, ACpuThatIsNotThereIsSaidAndNotFatal) {
  std::thread([] {
    RealtimeSetup setup;
    RealtimeConfig config = RealtimeConfig::none();
    config.cpu = 1000;
    setup.prepare_thread(config);
    const RealtimeSetting* affinity = find(setup.settings(), "CPU affinity");
    ASSERT_TRUE(affinity);
    EXPECT_TRUE(affinity->wanted);
    EXPECT_FALSE(affinity->granted);
    EXPECT_NE(affinity->text.find("1000"), std::string::npos);
  }).join();
}

TEST(RealtimeSetup, NothingWantedIsNothingDone) {
  RealtimeSetup setup;
  setup.prepare_process(RealtimeConfig::none());
  setup.prepare_thread(RealtimeConfig::none());
  for (const RealtimeSetting& s : setup.settings())
    EXPECT_FALSE(s.wanted || s.granted) << s.name << ": " << s.text;
  setup.restore_thread();
}

TEST(RealtimeSetup, ProbeLeavesNoTrace) {
  const int policy = sched_getscheduler(0);
  const auto settings = probe_realtime();
  EXPECT_GE(settings.size(), 8u);
  for (const RealtimeSetting& s : settings) EXPECT_FALSE(s.text.empty()) << s.name;
  EXPECT_EQ(sched_getscheduler(0), policy);
  EXPECT_EQ(locked_kib(), 0);
}

TEST(AvoidCpu, KeepsThreadsMadeMeanwhileOffTheLoopsCpu) {
  cpu_set_t before{};
  ASSERT_EQ(sched_getaffinity(0, sizeof before, &before), 0);
  const int cpu = loop_cpu({});
  if (CPU_COUNT(&before) < 2) {
    EXPECT_EQ(cpu, -1);
    return;
  }
  ASSERT_TRUE(CPU_ISSET(static_cast<unsigned>(cpu), &before));
  bool inherited = true;
  {
    const AvoidCpu rest(cpu);
    std::thread([&] {
      cpu_set_t mine{};
      sched_getaffinity(0, sizeof mine, &mine);
      inherited = CPU_ISSET(static_cast<unsigned>(cpu), &mine);
    }).join();
  }
  EXPECT_FALSE(inherited);
  cpu_set_t after{};
  ASSERT_EQ(sched_getaffinity(0, sizeof after, &after), 0);
  EXPECT_TRUE(CPU_EQUAL(&before, &after));
}

}  // namespace
}  // namespace rigor
