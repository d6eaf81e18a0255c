// A model that goes on in fixed steps from the start of a run, and its past.
//
// A command takes effect at the first instant of the grid t0 + k·step at or after its own. So a state depends
// on the commands and their instants alone, never on who asked when. Every sixteenth state and every one at
// which a command came is kept; the state at any instant is the nearest kept one before it, stepped on. What
// is kept reaches back 2048 entries: a minute while nobody commands, four seconds at least.
//
// Readers of the past hold no lock: entry n lies in place n % kEntries and says its number, so that a reader
// who was overtaken sees it and looks again.
#pragma once

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <limits>
#include <memory>
#include <vector>

#include "rt-core/published.h"
#include "rt-core/time.h"

namespace rigor {

/// `Model` has `State step(const State&, const Command&, std::int64_t k) const noexcept`: from grid instant k
/// to the next. State and Command are trivially copyable.
template <class Model, class State, class Command>
class StepHistory {
 public:
  StepHistory(const Model& model, Duration step) : model_(model), step_(step), entries_(kEntries) {}

  /// Writer: begins anew. Readers may be reading.
  void start(BenchTime t0, const State& state, const Command& command) {
    t0_.store(t0.ns(), std::memory_order_relaxed);
    now_ = {};
    now_.state = state;
    now_.active = command;
    now_.number = published_.load(std::memory_order_relaxed);
    first_.store(now_.number, std::memory_order_relaxed);
    publish();
  }

  /// Writer: to the last grid instant at or before `t`.
  void advance(BenchTime t) {
    const std::int64_t k = grid(t);
    while (now_.k < k) {
      take_pending();
      now_.state = model_.step(now_.state, now_.active, now_.k);
      ++now_.k;
      if (now_.k % kKeepEvery == 0) next_entry();
    }
    take_pending();
  }
  /// Writer: from the first grid instant at or after `t` this is what counts. Instants do not decrease; an
  /// earlier one counts as the latest.
  void command(BenchTime t, const Command& command) {
    advance(t);
    const std::int64_t since = std::max<std::int64_t>(0, (t - t0()).ns());
    const std::int64_t k = std::max(now_.k, (since + step_.ns() - 1) / step_.ns());
    now_.pending = command;
    now_.pending_k = k;
    if (entry_k_ == now_.k)
      publish();  // in place of what was kept of this instant
    else
      next_entry();
  }
  /// Any thread: where nobody has read or written for long, takes the writer's part over for a moment, if the
  /// writer's lock is free, so that a reader has never much to step through. Stays well behind `t`: what
  /// takes effect until then has been told long ago.
  template <class Mutex>
  void keep_up(BenchTime t, Mutex& mutex) noexcept {
    if (t - newest() < seconds(1) || !mutex.try_lock()) return;
    advance(t - milliseconds(500));
    mutex.unlock();
  }
  /// Writer: the state at the instant up to which it was advanced, and what it was told last.
  [[nodiscard]] const State& state() const noexcept { return now_.state; }
  [[nodiscard]] const Command& told() const noexcept {
    return now_.pending_k >= 0 ? now_.pending : now_.active;
  }

  struct Moment {
    State before{}, after{};  ///< at the grid instants around
    double since_s = 0;       ///< since `before`; below the step
  };
  /// Any thread. Beyond what the writer has advanced to, the last command is taken to go on. Before the
  /// start, the start.
  [[nodiscard]] Moment at(BenchTime t) const noexcept {
    const Entry e = entry_before(grid(t));
    Moment m;
    m.before = e.state;
    std::int64_t k = e.k;
    const auto told = [&e](std::int64_t at) -> const Command& {
      return e.pending_k >= 0 && at >= e.pending_k ? e.pending : e.active;
    };
    for (const std::int64_t end = grid(t); k < end; ++k) m.before = model_.step(m.before, told(k), k);
    const double since_s = static_cast<double>((t - t0()).ns() - k * step_.ns()) * 1e-9;
    if (t <= t0() || since_s < 0) {  // before the start, or before all that is kept
      m.after = m.before;
      return m;
    }
    m.after = model_.step(m.before, told(k), k);
    m.since_s = since_s;
    return m;
  }
  [[nodiscard]] BenchTime t0() const noexcept { return BenchTime(t0_.load(std::memory_order_relaxed)); }
  [[nodiscard]] Duration step() const noexcept { return step_; }
  /// Any thread: the instant of the newest entry that is kept.
  [[nodiscard]] BenchTime newest() const noexcept {
    return t0() + step_ * newest_k_.load(std::memory_order_relaxed);
  }

 private:
  static constexpr std::size_t kEntries = 2048;
  static constexpr std::int64_t kKeepEvery = 16;
  struct Entry {
    std::uint64_t number = 0;
    std::int64_t k = 0;
    State state{};
    Command active{}, pending{};
    std::int64_t pending_k = -1;  ///< from here on `pending` counts; -1: there is none
  };

  [[nodiscard]] std::int64_t grid(BenchTime t) const noexcept {
    return std::max<std::int64_t>(0, (t - t0()).ns() / step_.ns());
  }
  void take_pending() {
    if (now_.pending_k < 0 || now_.pending_k > now_.k) return;
    now_.active = now_.pending;
    now_.pending_k = -1;
  }
  void next_entry() {
    now_.number = published_.load(std::memory_order_relaxed);
    publish();
  }
  void publish() {
    entry_k_ = now_.k;
    entries_[now_.number % kEntries].store(now_);
    newest_k_.store(now_.k, std::memory_order_relaxed);
    published_.store(now_.number + 1, std::memory_order_release);
  }

  /// The newest entry at or before k; the oldest where all are later.
  [[nodiscard]] Entry entry_before(std::int64_t k) const noexcept {
    Entry found;
    for (;;) {
      const std::uint64_t count = published_.load(std::memory_order_acquire);
      if (count == 0) return found;
      const std::uint64_t oldest =
          std::max(first_.load(std::memory_order_relaxed), count > kEntries - 1 ? count - (kEntries - 1) : 0);
      // The first of [low, high) is at or before k, or the oldest; all from high on are later.
      std::uint64_t low = oldest, high = count;
      bool overtaken = false;
      // Mostly the last few are asked for.
      for (std::uint64_t back = 1; high - low > 1 && !overtaken; back *= 2) {
        const std::uint64_t at = high - std::min(back, high - low);
        const Entry e = entries_[at % kEntries].load();
        overtaken = e.number != at;
        if (e.k <= k) {
          low = at;
          break;
        }
        high = std::max(at, low + 1);
      }
      while (high - low > 1 && !overtaken) {
        const std::uint64_t middle = low + (high - low) / 2;
        const Entry e = entries_[middle % kEntries].load();
        overtaken = e.number != middle;
        (e.k <= k ? low : high) = middle;
      }
      found = entries_[low % kEntries].load();
      if (!overtaken && found.number == low) return found;
    }
  }

  const Model& model_;
  Duration step_;
  Entry now_;  // the writer's
  std::int64_t entry_k_ = -1;
  std::atomic<std::int64_t> t0_{std::numeric_limits<std::int64_t>::max() / 4};
  std::atomic<std::int64_t> newest_k_{0};
  std::atomic<std::uint64_t> first_{0}, published_{0};
  std::vector<Published<Entry>> entries_;
};

}  // namespace rigor
