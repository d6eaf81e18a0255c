#include "rt-core/stop.h"

#include <time.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <csignal>
#include <cstring>

#include "rt-core/heartbeat.h"

namespace rigor {
namespace {

constexpr int kSignals = 65;  // of Linux: 1 to 64
constexpr std::int64_t kEndsAtOnceAfter_ns = 3'000'000'000;
constexpr long kCrashWait_ns = 300'000'000;

// Signal handlers know globals only.
std::atomic<StopSource*> g_source{nullptr};
std::atomic<Heartbeat*> g_heartbeat{nullptr};
std::atomic<std::int64_t> g_first_ns{0};  // when the first stop signal came
std::atomic<bool> g_crashing{false};
std::array<struct sigaction, kSignals> g_old;
std::array<bool, kSignals> g_taken;
std::array<struct sigaction, kSignals> g_old_crash;
std::array<bool, kSignals> g_taken_crash;

constexpr std::array kStops{SIGHUP,    SIGINT,  SIGQUIT, SIGTERM, SIGALRM, SIGUSR1,  SIGUSR2,
                            SIGVTALRM, SIGPROF, SIGXCPU, SIGIO,   SIGPWR,  SIGSTKFLT};
constexpr std::array kCrashes{SIGSEGV, SIGABRT, SIGBUS, SIGFPE, SIGILL, SIGSYS, SIGTRAP};
constexpr std::array kSuspends{SIGTSTP, SIGTTIN, SIGTTOU};

void say(const char* text) noexcept { [[maybe_unused]] const auto n = write(2, text, std::strlen(text)); }

std::int64_t now_ns() noexcept {
  timespec t{};
  clock_gettime(CLOCK_MONOTONIC, &t);
  return std::int64_t{t.tv_sec} * 1'000'000'000 + t.tv_nsec;
}

void end_by(int number) noexcept {
  struct sigaction plain {};
  plain.sa_handler = SIG_DFL;
  sigaction(number, &plain, nullptr);
  raise(number);  // blocked here, delivered when the handler returns
}

void stop_by(int number) noexcept {
  StopSource* source = g_source.load(std::memory_order_acquire);
  if (!source) return;
  std::int64_t first = 0;
  const std::int64_t now = now_ns();
  if (g_first_ns.compare_exchange_strong(first, now)) {
    source->request(StopReason::signal);
    return;
  }
  // A terminal that goes away sends SIGHUP more than once, and fingers are quick: only an insistent user, or
  // a supervisor that has lost its patience, ends what is busy making devices safe.
  if (number != SIGINT && number != SIGTERM && number != SIGQUIT) return;
  if (now - first > kEndsAtOnceAfter_ns)
    end_by(number);
  else if (number == SIGINT)
    say("rigor: stopping; Ctrl-C after 3 s ends it at once\n");
}

extern "C" {

void rigor_on_stop_signal(int number) {
  const int error = errno;
  stop_by(number);
  errno = error;
}

void rigor_on_suspend_signal(int) {
  const int error = errno;
  say("rigor: a run cannot be suspended, its devices would go on; Ctrl-C ends it\n");
  errno = error;
}

void rigor_on_crash_signal(int number, siginfo_t* info, void*) {
  const int error = errno;
  const bool sent = info->si_code <= 0 && info->si_pid != getpid();
  if (sent && g_source.load(std::memory_order_acquire)) {
    stop_by(number);
  } else if (Heartbeat* heartbeat = g_heartbeat.load(std::memory_order_acquire)) {
    if (!g_crashing.exchange(true)) {
      heartbeat->declare_stopped(StopReason::failed);
      say("rigor: crashed; the devices are made safe\n");
    }
    timespec left{0, kCrashWait_ns};
    while (nanosleep(&left, &left) != 0 && errno == EINTR) {
    }
    end_by(number);
  } else {
    end_by(number);
  }
  errno = error;
}

}  // extern "C"

template <class Signals>
void restore(const Signals& signals, std::array<struct sigaction, kSignals>& old,
             std::array<bool, kSignals>& taken) noexcept {
  for (const int s : signals) {
    const auto i = static_cast<std::size_t>(s);
    if (taken[i]) sigaction(s, &old[i], nullptr);
    taken[i] = false;
  }
}

bool is_default(const struct sigaction& action) noexcept {
  return (action.sa_flags & SA_SIGINFO) == 0 && action.sa_handler == SIG_DFL;
}

void take(int s, const struct sigaction& action, bool always, std::array<struct sigaction, kSignals>& old,
          std::array<bool, kSignals>& taken) noexcept {
  const auto i = static_cast<std::size_t>(s);
  if (sigaction(s, nullptr, &old[i]) != 0 || (!always && !is_default(old[i]))) return;
  taken[i] = sigaction(s, &action, nullptr) == 0;
}

std::array<int, kSignals> realtime_signals() noexcept {
  std::array<int, kSignals> all{};  // the rest is 0, which is no signal
  std::size_t n = 0;
  for (int s = SIGRTMIN; s <= SIGRTMAX && n < all.size(); ++s) all[n++] = s;
  return all;
}

void take_crashes(std::array<struct sigaction, kSignals>& old, std::array<bool, kSignals>& taken) noexcept {
  struct sigaction action {};
  action.sa_sigaction = rigor_on_crash_signal;
  sigemptyset(&action.sa_mask);
  action.sa_flags = SA_SIGINFO | SA_ONSTACK;
  for (const int s : kCrashes) take(s, action, false, old, taken);
}

}  // namespace

SignalStop::SignalStop(StopSource& source, Suspend suspend) noexcept {
  g_first_ns.store(0);
  g_source.store(&source, std::memory_order_release);
  struct sigaction action {};
  action.sa_handler = rigor_on_stop_signal;
  sigemptyset(&action.sa_mask);
  action.sa_flags = SA_RESTART;
  for (const int s : kStops) take(s, action, s == SIGINT || s == SIGTERM, g_old, g_taken);
  for (const int s : realtime_signals())
    if (s > 0) take(s, action, false, g_old, g_taken);
  take_crashes(g_old, g_taken);
  if (suspend == Suspend::allow) return;
  action.sa_handler = rigor_on_suspend_signal;
  for (const int s : kSuspends) take(s, action, false, g_old, g_taken);
}

SignalStop::~SignalStop() {
  // What was said before need not be said again, while the program comes to its end.
  if (g_first_ns.load() != 0) {
    struct sigaction ignore {};
    ignore.sa_handler = SIG_IGN;
    for (const int s : kStops)
      if (s != SIGINT && s != SIGTERM && s != SIGQUIT) g_old[static_cast<std::size_t>(s)] = ignore;
  }
  restore(kStops, g_old, g_taken);
  restore(realtime_signals(), g_old, g_taken);
  restore(kCrashes, g_old, g_taken);
  restore(kSuspends, g_old, g_taken);
  g_source.store(nullptr, std::memory_order_release);
}

CrashGuard::CrashGuard(Heartbeat& heartbeat) noexcept {
  g_crashing.store(false);
  g_heartbeat.store(&heartbeat, std::memory_order_release);
  // The loop's own stack may be what is broken.
  alignas(16) static std::array<char, 64 * 1024> stack;
  stack_t own{};
  own.ss_sp = stack.data();
  own.ss_size = stack.size();
  stack_t present{};
  if (sigaltstack(nullptr, &present) == 0 && (present.ss_flags & SS_DISABLE) != 0) sigaltstack(&own, nullptr);
  take_crashes(g_old_crash, g_taken_crash);
}

CrashGuard::~CrashGuard() {
  restore(kCrashes, g_old_crash, g_taken_crash);
  g_heartbeat.store(nullptr, std::memory_order_release);
}

}  // namespace rigor
