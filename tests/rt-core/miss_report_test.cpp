// One cause planted in each test; the report has to name it.
#include "rt-core/miss_report.h"

#include <gtest/gtest.h>
#include <pthread.h>
#include <sched.h>
#include <sys/mman.h>

#include <atomic>
#include <thread>

#include "rt-core/executive.h"

namespace rigor {
namespace {

constexpr std::uint64_t kPlanted = 20;

void busy(Duration d) {
  const std::int64_t end = monotonic_now().ns() + d.ns();
  while (monotonic_now().ns() < end) {
  }
}

ExecutiveConfig config() {
  ExecutiveConfig c;
  c.cycles = 60;
  c.period = milliseconds(5);
  c.realtime.lock_memory = false;
  c.realtime.hold_dma_latency = false;
  return c;
}

template <class F>
RunSummary run_with(ExecutiveConfig c, F&& f) {
  Executive loop(c);
  EXPECT_TRUE(loop.add_step({.name = "quiet"}, [](const CycleContext&) noexcept {}));
  EXPECT_TRUE(loop.add_step({.name = "planted"}, [&](const CycleContext& k) noexcept {
    if (k.index == kPlanted) f();
  }));
  EXPECT_TRUE(loop.arm());
  const auto s = loop.run({}, bench_now() + milliseconds(200));
  EXPECT_TRUE(s) << s.error().text();
  EXPECT_TRUE(loop.disarm());
  return *s;
}

const Miss* planted(const RunSummary& s) {
  for (const Miss& m : s.misses.misses)
    if (m.cycle == kPlanted) return &m;
  return nullptr;
}

/// A stall of the host may cover what was planted: three tries.
template <class F>
void expect_cause(MissCause cause, F&& attempt) {
  std::string seen;
  for (int i = 0; i < 3; ++i) {
    const RunSummary s = attempt();
    const Miss* m = planted(s);
    if (m && m->cause == cause) {
      EXPECT_EQ(s.misses.total, s.misses.misses.size() + s.misses.dropped);
      EXPECT_GE(s.misses.by_cause[static_cast<std::size_t>(cause)], 1u);
      return;
    }
    seen += (m ? describe(*m, s.period, s.steps[m->longest_step].name) : std::string("no miss")) + "\n";
  }
  FAIL() << "expected " << to_string(cause) << ", got\n" << seen;
}

bool fifo_allowed() {
  bool allowed = false;
  std::thread([&] {
    sched_param p{};
    p.sched_priority = 10;
    allowed = sched_setscheduler(0, SCHED_FIFO, &p) == 0;
  }).join();
  return allowed;
}

TEST(MissReport, ABusyStepIsExecutionAndIsNamed) {
  expect_cause(MissCause::execution, [] {
    const RunSummary s = run_with(config(), [] { busy(milliseconds(8)); });
    if (const Miss* m = planted(s)) {
      EXPECT_EQ(s.steps[m->longest_step].name, "planted");
      EXPECT_GE(m->longest_step_ran, milliseconds(8));
    }
    return s;
  });
}

TEST(MissReport, AStepThatSleepsIsExecutionToo) {
  expect_cause(MissCause::execution, [] {
    return run_with(config(), [] { std::this_thread::sleep_for(std::chrono::milliseconds(12)); });
  });
}

TEST(MissReport, FreshPagesArePageFaults) {
  expect_cause(MissCause::page_fault, [] {
    constexpr std::size_t kBytes = 128u << 20;
    void* memory = mmap(nullptr, kBytes, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    EXPECT_NE(memory, MAP_FAILED);
    madvise(memory, kBytes, MADV_NOHUGEPAGE);
    const RunSummary s = run_with(config(), [&] {
      for (std::size_t i = 0; i < kBytes; i += 4096) static_cast<volatile char*>(memory)[i] = 1;
    });
    munmap(memory, kBytes);
    return s;
  });
}

TEST(MissReport, AMoreUrgentThreadOnTheSameCpuIsPreemption) {
  if (!fifo_allowed())
    GTEST_SKIP() << "SCHED_FIFO is not allowed here: `ulimit -r` or CAP_SYS_NICE is needed";
  // Both ways to lose the CPU: in the middle of a step, and on waking up.
  for (const bool during_step : {true, false}) {
    expect_cause(MissCause::preemption, [&] {
      std::atomic<int> phase{0};
      std::atomic<std::int64_t> strike_at{0};
      cpu_set_t allowed;
      sched_getaffinity(0, sizeof allowed, &allowed);
      int cpu = 0;
      for (int i = 0; i < CPU_SETSIZE; ++i)
        if (CPU_ISSET(i, &allowed)) cpu = i;
      std::thread rival([&] {
        cpu_set_t one;
        CPU_ZERO(&one);
        CPU_SET(cpu, &one);
        sched_setaffinity(0, sizeof one, &one);
        sched_param p{};
        p.sched_priority = 90;
        sched_setscheduler(0, SCHED_FIFO, &p);
        while (phase == 0) std::this_thread::sleep_for(std::chrono::microseconds(200));
        while (monotonic_now().ns() < strike_at) std::this_thread::sleep_for(std::chrono::microseconds(100));
        busy(milliseconds(15));
      });
      ExecutiveConfig c = config();
      c.realtime.cpu = cpu;
      c.realtime.fifo_priority = 50;
      Executive loop(c);
      EXPECT_TRUE(loop.add_step({.name = "planted"}, [&](const CycleContext& k) noexcept {
        if (during_step ? k.index == kPlanted : k.index == kPlanted - 1) {
          // In the step: at once. On waking: a little before the next grid point.
          strike_at = during_step ? 0 : k.t_next.ns() - 700'000;
          phase = 1;
          if (during_step) busy(milliseconds(2));
        }
      }));
      EXPECT_TRUE(loop.arm());
      const auto s = loop.run({}, bench_now() + milliseconds(200));
      phase = 1;
      rival.join();
      EXPECT_TRUE(loop.disarm());
      return *s;
    });
  }
}

// The host cannot be asked to stall this machine: the rule itself is tested on numbers.
TEST(MissReport, TheRuleOnNumbers) {
  const Duration period = milliseconds(1);
  Miss m;
  m.overran = true;
  m.ran = milliseconds(30);
  m.cpu = microseconds(200);
  m.stolen = milliseconds(30);
  EXPECT_EQ(attribute(m, period), MissCause::host_steal);
  m.stolen = Duration(0);
  EXPECT_EQ(attribute(m, period), MissCause::unknown);
  m.preempted = 1;
  m.run_queue = milliseconds(29);
  EXPECT_EQ(attribute(m, period), MissCause::preemption);
  m.cpu = milliseconds(29);
  EXPECT_EQ(attribute(m, period), MissCause::execution);
  m.major_faults = 1;
  EXPECT_EQ(attribute(m, period), MissCause::page_fault);

  Miss late;
  late.late = milliseconds(30);
  late.overran = true;
  late.ran = microseconds(10);
  EXPECT_EQ(attribute(late, period), MissCause::late_wakeup);
  late.run_queue = milliseconds(28);
  EXPECT_EQ(attribute(late, period), MissCause::preemption);
  late.run_queue = Duration(0);
  late.stolen = milliseconds(20);
  EXPECT_EQ(attribute(late, period), MissCause::host_steal);
}

TEST(MissReport, TheHostsShareIsReadOfEveryCpuOfALargeMachine) {
  constexpr int kCpus = 512;
  const std::string longest = " 18446744073709551615";
  std::string stat = "cpu ";
  for (int i = 0; i < 10; ++i) stat += longest;
  for (int cpu = 0; cpu < kCpus; ++cpu) {
    stat += "\ncpu" + std::to_string(cpu);
    for (int i = 0; i < 7; ++i) stat += " 9223372036854775807";
    stat += " " + std::to_string(1000 + cpu) + longest + longest;
  }
  EXPECT_LT(stat.size(), room_for_proc_stat(kCpus));
  stat += "\nintr 1 2 3\n";
  EXPECT_EQ(stolen_ticks(stat.c_str(), 0), 1000);
  EXPECT_EQ(stolen_ticks(stat.c_str(), 51), 1051);
  EXPECT_EQ(stolen_ticks(stat.c_str(), kCpus - 1), 1000 + kCpus - 1);
  EXPECT_FALSE(stolen_ticks(stat.c_str(), kCpus));
}

TEST(MissReport, MissesBeyondTheRoomAreCounted) {
  ExecutiveConfig c = config();
  c.cycles = 1000;
  c.period = milliseconds(2);
  c.miss_capacity = 3;
  Executive loop(c);
  int slow = 10;
  ASSERT_TRUE(loop.add_step({.name = "slow"}, [&](const CycleContext&) noexcept {
    if (slow > 0) busy(microseconds(2'500));
    --slow;
  }));
  ASSERT_TRUE(loop.arm());
  const auto s = loop.run({}, bench_now() + milliseconds(200));
  ASSERT_TRUE(s) << s.error().text();
  EXPECT_EQ(s->misses.misses.size(), 3u);
  EXPECT_GE(s->misses.total, 10u);
  EXPECT_GE(s->misses.total, s->overruns);
  EXPECT_EQ(s->misses.dropped, s->misses.total - 3);
  EXPECT_EQ(s->cycles_run + s->cycles_skipped, 1000u);
}

}  // namespace
}  // namespace rigor
