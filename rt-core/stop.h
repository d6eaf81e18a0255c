// How a run is asked to end: by code, by Ctrl-C, by a supervisor, by a terminal that goes away.
//
//   StopSource stop;
//   SignalStop signals(stop);            // every signal that would end the process ends the run instead
//   executive.run(stop.token(), t0);     // returns at the next cycle boundary
#pragma once

#include <atomic>
#include <cstdint>

namespace rigor {

/// Why a loop stopped.
enum class StopReason : std::uint8_t {
  none,        ///< it still runs, or has not begun
  finished,    ///< the given number of cycles is done
  requested,   ///< StopSource::request() was called
  signal,      ///< a signal came that would have ended the process
  overrun,     ///< a cycle was too late, and the policy is `abort`
  failed,      ///< a step or a channel reported that the run cannot go on
  recording,   ///< the recording could not be continued
  application  ///< the application said that it cannot go on
};

[[nodiscard]] constexpr const char* to_string(StopReason r) noexcept {
  switch (r) {
    case StopReason::none:
      return "running";
    case StopReason::finished:
      return "finished";
    case StopReason::requested:
      return "stop requested";
    case StopReason::signal:
      return "interrupted by a signal";
    case StopReason::overrun:
      return "aborted: a cycle overran";
    case StopReason::failed:
      return "aborted: a step failed";
    case StopReason::recording:
      return "aborted: the recording could not be continued";
    case StopReason::application:
      return "aborted: the application cannot go on";
  }
  return "?";
}

class StopSource;

/// Reads a StopSource; a default one never stops. Any thread, wait-free. The source outlives its tokens.
class StopToken {
 public:
  StopToken() noexcept = default;
  [[nodiscard]] StopReason reason() const noexcept {
    return flag_ ? static_cast<StopReason>(flag_->load(std::memory_order_acquire)) : StopReason::none;
  }
  [[nodiscard]] bool stop_requested() const noexcept { return reason() != StopReason::none; }

 private:
  friend class StopSource;
  explicit StopToken(const std::atomic<std::uint8_t>* flag) noexcept : flag_(flag) {}
  const std::atomic<std::uint8_t>* flag_ = nullptr;
};

class StopSource {
 public:
  StopSource() noexcept = default;
  StopSource(const StopSource&) = delete;
  StopSource& operator=(const StopSource&) = delete;

  /// Any thread and signal handlers; the first reason stays. True if this call was the first.
  bool request(StopReason reason = StopReason::requested) noexcept {
    std::uint8_t none = 0;
    return flag_.compare_exchange_strong(none, static_cast<std::uint8_t>(reason), std::memory_order_acq_rel);
  }
  [[nodiscard]] StopToken token() const noexcept { return StopToken(&flag_); }
  [[nodiscard]] StopReason reason() const noexcept { return token().reason(); }

 private:
  std::atomic<std::uint8_t> flag_{0};
  static_assert(std::atomic<std::uint8_t>::is_always_lock_free, "the signal handler writes it");
};

/// While it lives, a signal whose default is to end the process requests a stop with reason `signal`: SIGINT,
/// SIGTERM, SIGHUP, SIGQUIT, SIGALRM, SIGUSR1, SIGUSR2, SIGVTALRM, SIGPROF, SIGXCPU, SIGIO, SIGPWR, SIGSTKFLT
/// and the real-time signals; and those of a crash where another process sent them. Further ones change
/// nothing, except that a SIGINT, SIGTERM or SIGQUIT that comes 3 s after the first ends the process at once.
/// Signals that were ignored before (nohup) or have a handler already are left alone; SIGINT and SIGTERM are
/// always taken. At its end all is as before; only where a signal came, SIGHUP and the others but SIGINT,
/// SIGTERM and SIGQUIT are ignored from then on. One at a time in a process. Setup thread.
class SignalStop {
 public:
  enum class Suspend : std::uint8_t {
    allow,
    refuse  ///< Ctrl-Z and the other stops of a terminal are answered with a message: devices would go on
  };
  explicit SignalStop(StopSource& source, Suspend suspend = Suspend::allow) noexcept;
  ~SignalStop();
  SignalStop(const SignalStop&) = delete;
  SignalStop& operator=(const SignalStop&) = delete;
};

class Heartbeat;

/// While it lives, a crash of the process (SIGSEGV, SIGABRT, SIGBUS, SIGFPE, SIGILL, SIGSYS, SIGTRAP) first
/// declares the heartbeat stopped and leaves the sinks' threads 300 ms to make their devices safe, then ends
/// the process as it would have ended. Best effort: a sink whose own thread crashed, or that waits for what
/// the crashed thread holds, makes nothing safe. Signals that have a handler already are left alone. One at a
/// time in a process. Setup thread.
class CrashGuard {
 public:
  explicit CrashGuard(Heartbeat& heartbeat) noexcept;
  ~CrashGuard();
  CrashGuard(const CrashGuard&) = delete;
  CrashGuard& operator=(const CrashGuard&) = delete;
};

}  // namespace rigor
