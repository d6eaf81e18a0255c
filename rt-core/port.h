// A port: what the loop sees of one channel, by logical execution time.
//
//   capture          arrival        release
//   ───●────────────────●──────────────●────────────── time
//      │ measured       │ it is here   │ first cycle at or after: the loop sees it (fresh), then holds it
//      (held)
//
// A sample that is here early waits; one that is not here at its release makes the port `overdue`, and it
// becomes visible in the first cycle after it came. So what the application computes depends on the latency
// of the device that is modelled and not on how fast a computer was.
#pragma once

#include <cstddef>
#include <cstdint>

#include "rt-core/fixed_ring.h"
#include "rt-core/pool.h"
#include "rt-core/stamp.h"

namespace rigor {

enum class PortStatus : std::uint8_t {
  never,    ///< nothing was visible yet, and nothing is overdue
  fresh,    ///< a new sample became visible in this cycle
  held,     ///< the sample of an earlier cycle is held, none was due
  overdue,  ///< a sample was due by now and is not here; the old one is held, or dropped if the policy says
            ///< so
  disconnected  ///< the source is gone, or silent for longer than `lost_after`
};

enum class LatePolicy : std::uint8_t { hold, drop };

struct PortTiming {
  Duration period{};     ///< nominal; 0 for an aperiodic channel, which is never late
  Duration tolerance{};  ///< how long past its release a sample may be missing before it is late
  Duration lost_after = milliseconds(500);
  LatePolicy on_late = LatePolicy::hold;
};

struct PortCounters {
  std::uint64_t fresh = 0;                ///< samples that became visible
  std::uint64_t superseded = 0;           ///< samples that a newer one of the same cycle overtook
  std::uint64_t overdue_cycles = 0;       ///< cycles with status overdue
  std::uint64_t late_samples = 0;         ///< samples that arrived after their release
  std::uint64_t disconnected_cycles = 0;  ///< cycles with status disconnected
  std::uint64_t lost_samples = 0;         ///< gaps in the sequence, and what the source said was lost
  std::uint64_t overflow = 0;             ///< samples dropped because more than kPending waited
};

/// T has a member `Stamp stamp`. All calls: loop thread; noexcept, no allocation.
template <class T>
class Port {
 public:
  static constexpr std::size_t kPending = 64;

  void configure(const PortTiming& timing, BenchTime t_start) noexcept {
    timing_ = timing;
    t_quiet_since_ = t_start;
  }
  /// Hand over a sample that has arrived; samples come in the order of their release.
  void push(Lease<T> sample) noexcept {
    if (pending_.full()) {
      ++counters_.overflow;
      return;
    }
    pending_.push_back(std::move(sample));
  }
  /// Make visible what is due at `now`. Call once in each cycle, with increasing `now`.
  void advance(BenchTime now, bool source_connected) noexcept {
    bool fresh = false;
    while (!pending_.empty() && pending_.front()->stamp.t_release <= now) {
      if (fresh) ++counters_.superseded;
      take(now);
      fresh = true;
    }
    if (fresh) {
      status_ = PortStatus::fresh;
      ++counters_.fresh;
      return;
    }
    const bool silent =
        timing_.period.ns() > 0 && now - t_quiet_since_ > timing_.lost_after && pending_.empty();
    const bool overdue =
        timing_.period.ns() > 0 && seen_ && now > visible_release_ + timing_.period + timing_.tolerance;
    if ((!source_connected && pending_.empty()) || silent) {
      status_ = PortStatus::disconnected;
      ++counters_.disconnected_cycles;
    } else if (overdue) {
      status_ = PortStatus::overdue;
      ++counters_.overdue_cycles;
      if (timing_.on_late == LatePolicy::drop) visible_.reset();
    } else {
      status_ = visible_ || seen_ ? PortStatus::held : PortStatus::never;
    }
  }
  /// Replay: force what a recording says was visible. `fresh` takes the pending sample with that sequence.
  /// False, and the port as in the cycle before but for its status, when that sample is not there.
  bool obey(PortStatus status, std::uint64_t sequence, BenchTime now) noexcept {
    status_ = status;
    if (status == PortStatus::fresh) {
      while (!pending_.empty() && pending_.front()->stamp.sequence < sequence) {
        ++counters_.superseded;
        take(now);
      }
      if (pending_.empty() || pending_.front()->stamp.sequence != sequence) return false;
      take(now);
      ++counters_.fresh;
    } else if (status == PortStatus::overdue) {
      ++counters_.overdue_cycles;
      if (timing_.on_late == LatePolicy::drop) visible_.reset();
    } else if (status == PortStatus::disconnected) {
      ++counters_.disconnected_cycles;
    }
    return true;
  }
  [[nodiscard]] PortStatus status() const noexcept { return status_; }
  /// The visible sample; empty before the first.
  [[nodiscard]] const Lease<T>& sample() const noexcept { return visible_; }
  [[nodiscard]] Duration age(BenchTime now) const noexcept {
    return visible_ ? now - visible_->stamp.t_capture : Duration(0);
  }
  [[nodiscard]] const PortCounters& counters() const noexcept { return counters_; }
  [[nodiscard]] const PortTiming& timing() const noexcept { return timing_; }

 private:
  void take(BenchTime now) noexcept {
    visible_ = pending_.pop_front();
    const Stamp& s = visible_->stamp;
    if (s.t_arrival > s.t_release) ++counters_.late_samples;
    const std::uint64_t gap = seen_ && s.sequence > last_sequence_ ? s.sequence - last_sequence_ - 1 : 0;
    counters_.lost_samples += gap > s.lost_before ? gap : s.lost_before;  // both count the same losses
    last_sequence_ = s.sequence;
    visible_release_ = s.t_release;
    t_quiet_since_ = now;
    seen_ = true;
  }

  FixedRing<Lease<T>, kPending> pending_;
  Lease<T> visible_;
  BenchTime visible_release_;
  BenchTime t_quiet_since_;
  std::uint64_t last_sequence_ = 0;
  bool seen_ = false;
  PortStatus status_ = PortStatus::never;
  PortTiming timing_;
  PortCounters counters_;
};

}  // namespace rigor
