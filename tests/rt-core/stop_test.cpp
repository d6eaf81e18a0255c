// Stops by signals, and what a crash leaves time for.
#include "rt-core/stop.h"

#include <gtest/gtest.h>
#include <signal.h>
#include <sys/mman.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <thread>

#include "rt-core/heartbeat.h"

namespace rigor {
namespace {

TEST(SignalStop, EverySignalThatWouldEndTheProcessRequestsAStop) {
  for (const int s : {SIGHUP, SIGINT, SIGQUIT, SIGTERM, SIGALRM, SIGUSR1, SIGUSR2, SIGVTALRM, SIGPROF,
                      SIGXCPU, SIGIO, SIGPWR, SIGSTKFLT, SIGRTMIN, SIGRTMAX}) {
    ::signal(s, SIG_DFL);
    StopSource source;
    const SignalStop signals(source);
    raise(s);
    EXPECT_EQ(source.reason(), StopReason::signal) << s;
    raise(s);  // and a second one changes nothing
  }
  raise(SIGHUP);  // nor does one that comes while the program ends
}

TEST(SignalStop, WhatIsIgnoredStaysIgnoredAndAllIsAsBefore) {
  const auto handler = [](int s) {
    struct sigaction now {};
    sigaction(s, nullptr, &now);
    return now.sa_handler;
  };
  constexpr std::array kTaken{SIGTERM, SIGTSTP, SIGSEGV};  // the last is a sanitizer's, where there is one
  std::array<sighandler_t, kTaken.size()> before{};
  std::transform(kTaken.begin(), kTaken.end(), before.begin(), handler);
  ::signal(SIGHUP, SIG_IGN);
  StopSource source;
  {
    const SignalStop signals(source, SignalStop::Suspend::refuse);
    raise(SIGHUP);
    EXPECT_EQ(source.reason(), StopReason::none);
    raise(SIGTSTP);  // refused, else this test would be suspended
  }
  ::signal(SIGHUP, SIG_DFL);
  for (std::size_t i = 0; i < kTaken.size(); ++i) EXPECT_EQ(handler(kTaken[i]), before[i]) << kTaken[i];
}

int crash(int signal) {
  auto* safe = static_cast<std::atomic<int>*>(
      mmap(nullptr, 4096, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0));
  safe->store(0);
  const pid_t pid = fork();
  if (pid == 0) {
    for (int s = 1; s < 32; ++s) ::signal(s, SIG_DFL);
    Heartbeat heartbeat;
    heartbeat.restart(false);
    heartbeat.beat(BenchTime(monotonic_now().ns()));
    StopSource source;
    const SignalStop signals(source);
    const CrashGuard guard(heartbeat);
    std::atomic<bool> begun = false;
    std::thread sink([&] {
      begun = true;
      while (!heartbeat.expired(monotonic_now(), seconds(60))) std::this_thread::yield();
      safe->store(1);
      pause();
    });
    while (!begun) std::this_thread::yield();
    if (signal == SIGABRT) std::abort();
    raise(signal);
    _exit(99);
  }
  int status = 0;
  waitpid(pid, &status, 0);
  EXPECT_EQ(safe->load(), 1) << "the sink had no time";
  munmap(safe, 4096);
  return WIFSIGNALED(status) ? WTERMSIG(status) : -1;
}

TEST(CrashGuard, LeavesTheSinksTimeAndEndsAsItWouldHaveEnded) {
  for (const int s : {SIGSEGV, SIGABRT, SIGBUS, SIGFPE, SIGILL}) EXPECT_EQ(crash(s), s);
}

}  // namespace
}  // namespace rigor
