// How a run is asked to end: by code, by Ctrl-C, by a supervisor.
//
//   StopSource stop;
//   SignalStop signals(stop);            // SIGINT, SIGTERM end the run while `signals` lives
//   executive.run(stop.token(), t0);     // returns at the next cycle boundary
#pragma once

#include <atomic>
#include <cstdint>

namespace rigor {

/// Why a loop stopped.
enum class StopReason : std::uint8_t {
  none,       ///< it still runs, or has not begun
  finished,   ///< the given number of cycles is done
  requested,  ///< StopSource::request() was called
  signal,     ///< SIGINT or SIGTERM came
  overrun,    ///< a cycle was too late, and the policy is `abort`
  failed      ///< a step or a channel reported that the run cannot go on
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

/// While it lives, SIGINT and SIGTERM request a stop with reason `signal`; a second one ends the process as
/// if there were no handler. One at a time in a process. Setup thread.
class SignalStop {
 public:
  explicit SignalStop(StopSource& source) noexcept;
  ~SignalStop();
  SignalStop(const SignalStop&) = delete;
  SignalStop& operator=(const SignalStop&) = delete;
};

}  // namespace rigor
