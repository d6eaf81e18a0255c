// The proof of real-time safety: a loop with ports, rings, pools and a trace does nothing that could make it
// wait, and the guard that says so is seen to catch one planted fault of each kind.
#include "rt-core/realtime_guard.h"

#include <gtest/gtest.h>
#include <pthread.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <cstdio>
#include <memory>
#include <mutex>

#include "rt-core/clock_map.h"
#include "rt-core/executive.h"
#include "rt-core/port.h"
#include "rt-core/spsc_ring.h"
#include "rt-core/trace.h"

namespace rigor {
namespace {

class GuardTest : public testing::Test {
 protected:
  void SetUp() override { installed_ = guard::install(); }
  void TearDown() override { guard::uninstall(); }

  /// A loop of `cycles` with the step f; what the guard found.
  template <class F>
  guard::Report run(std::uint64_t cycles, F&& f, Trace* trace = nullptr) {
    ExecutiveConfig c;
    c.cycles = cycles;
    c.on_overrun = OverrunPolicy::log;  // every cycle runs, also the one with the planted fault
    c.spin = microseconds(50);
    c.trace = trace;
    c.realtime = RealtimeConfig{};
    Heartbeat heartbeat;
    c.heartbeat = &heartbeat;
    Executive loop(c);
    EXPECT_TRUE(loop.add_step({.name = "step"}, std::forward<F>(f)));
    EXPECT_TRUE(loop.arm());
    for (const RealtimeSetting& s : loop.settings())
      if (s.name == "memory lock") memory_locked_ = s.granted;
    guard::clear();
    const auto s = loop.run({}, bench_now() + milliseconds(200));
    EXPECT_TRUE(s) << s.error().text();
    EXPECT_TRUE(loop.disarm());
    return guard::report();
  }
  Status installed_;
  bool memory_locked_ = false;
};

TEST_F(GuardTest, ACleanLoopOf2000CyclesIsClean) {
  struct Thing {
    Stamp stamp;
    double value[64];
  };
  Pool<Thing> pool(16);
  SpscRing<Lease<Thing>> ring(16);
  Port<Thing> port;
  port.configure({milliseconds(1), milliseconds(1), milliseconds(500), LatePolicy::hold}, BenchTime(0));
  ClockMap map;
  map.add_latch(DeviceTime(0), BenchTime(1000), BenchTime(2000));
  Trace trace;
  std::uint64_t fresh = 0;
  const guard::Report r = run(
      2000,
      [&](const CycleContext& c) noexcept {
        if (WritableSlot<Thing> slot = pool.try_acquire()) {
          slot->stamp.sequence = c.index;
          slot->stamp.t_release = c.t;
          (void)ring.try_push(std::move(slot));
        }
        for (Lease<Thing> lease; ring.try_pop(lease);) port.push(std::move(lease));
        port.advance(c.t, true);
        fresh += port.status() == PortStatus::fresh && map.map(DeviceTime(5)).known;
      },
      &trace);
  EXPECT_GT(fresh, 1000u);
  EXPECT_EQ(r.allocations, 0u) << r.text();
  EXPECT_EQ(r.locks, 0u) << r.text();
  EXPECT_EQ(r.system_calls, 0u) << r.text();
  if (!memory_locked_) GTEST_SKIP() << "page faults are not judged: memory may not be locked here";
  EXPECT_EQ(r.page_faults, 0u) << r.text();
  EXPECT_TRUE(r.clean());
}

TEST_F(GuardTest, CatchesAPlantedAllocation) {
  const guard::Report r = run(20, [](const CycleContext& c) noexcept {
    if (c.index == 10) {
      auto p = std::make_unique<int>(1);
      asm volatile("" : : "r"(p.get()) : "memory");  // or the compiler leaves it out
    }
  });
  EXPECT_EQ(r.allocations, 2u) << r.text();  // new and delete
  EXPECT_EQ(r.locks, 0u) << r.text();
  ASSERT_GE(r.findings.size(), 1u);
  EXPECT_STREQ(r.findings[0].what, "malloc");
  EXPECT_GT(r.findings[0].depth, 3);
}

TEST_F(GuardTest, CatchesALockEvenIfNobodyHoldsIt) {
  std::mutex mutex;
  const guard::Report r = run(20, [&](const CycleContext& c) noexcept {
    if (c.index == 10) const std::lock_guard lock(mutex);
  });
  EXPECT_EQ(r.locks, 1u) << r.text();
  EXPECT_EQ(r.allocations, 0u) << r.text();
}

TEST_F(GuardTest, CatchesAPageFault) {
  constexpr std::size_t kBytes = 64 * 4096;
  void* memory = mmap(nullptr, kBytes, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
  ASSERT_NE(memory, MAP_FAILED);
  madvise(memory, kBytes, MADV_NOHUGEPAGE);
  const guard::Report r = run(20, [&](const CycleContext& c) noexcept {
    // Locked memory is already there at arm: give it back first, outside of what is watched, and touch it
    // then.
    if (c.index == 5) {
      munlock(memory, kBytes);
      madvise(memory, kBytes, MADV_DONTNEED);
    }
    if (c.index == 10)
      for (std::size_t i = 0; i < kBytes; i += 4096) static_cast<volatile char*>(memory)[i] = 1;
  });
  munmap(memory, kBytes);
  EXPECT_GE(r.page_faults, 64u) << r.text();
}

TEST_F(GuardTest, CatchesBlockingSystemCallsFromWhereverTheyCome) {
  if (!installed_) GTEST_SKIP() << installed_.error().text();
  int pipe_ends[2];
  ASSERT_EQ(pipe(pipe_ends), 0);
  std::FILE* file = std::fopen("/dev/null", "w");
  ASSERT_TRUE(file);
  std::setvbuf(file, nullptr, _IONBF, 0);
  char byte = 'x';
  long raw = -1;
  bool worked = true;
  const guard::Report r = run(30, [&](const CycleContext& c) noexcept {
    if (c.index == 5) worked = worked && write(pipe_ends[1], &byte, 1) == 1;
    if (c.index == 10) {
      timespec t{0, 1000};
      nanosleep(&t, nullptr);
    }
    if (c.index == 15) std::fputs("x", file);  // within libc: cannot be seen by standing in front of write
    if (c.index == 20) {                       // no libc at all
      asm volatile("syscall" : "=a"(raw) : "a"(SYS_sched_yield) : "rcx", "r11", "memory");
    }
    if (c.index == 25) worked = worked && read(pipe_ends[0], &byte, 1) == 1;
  });
  std::fclose(file);
  close(pipe_ends[0]);
  close(pipe_ends[1]);
  EXPECT_TRUE(worked) << "a call that is noted is made all the same";
  EXPECT_EQ(raw, 0);
  EXPECT_EQ(r.system_calls, 5u) << r.text();
  EXPECT_EQ(r.allocations, 0u) << r.text();
  const std::string text = r.text();
  for (const char* name : {"(write)", "(nanosleep)", "(sched_yield)", "(read)"})
    EXPECT_TRUE(text.find(name) != std::string::npos ||
                (std::string(name) == "(nanosleep)" && text.find("(clock_nanosleep)") != std::string::npos))
        << name << "\n"
        << text;
}

TEST_F(GuardTest, WhatHappensOutsideTheLoopIsNobodysBusiness) {
  guard::clear();
  std::mutex mutex;
  const std::lock_guard lock(mutex);
  auto p = std::make_unique<int>(1);
  asm volatile("" : : "r"(p.get()) : "memory");
  EXPECT_TRUE(guard::report().clean());
}

}  // namespace
}  // namespace rigor
