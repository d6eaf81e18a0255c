// Which side of a pair is handed on: asked for by any thread, carried out by the loop at the start of a
// cycle.
#pragma once

#include <atomic>
#include <cstdint>

namespace rigor {

enum class PairSide : std::uint8_t { real, simulated };
[[nodiscard]] constexpr PairSide other(PairSide s) noexcept {
  return s == PairSide::real ? PairSide::simulated : PairSide::real;
}
[[nodiscard]] constexpr const char* name_of(PairSide s) noexcept {
  return s == PairSide::real ? "real" : "simulated";
}

/// Memory order: who asks for a side releases, and the loop that carries it out acquires, so that what was
/// prepared for the switch is there when it happens. Who only reads the side gets no order with it.
/// `Atomic` is std::atomic; tests put their model of memory in its place (tests/rt-core/lock_free_test.cpp).
template <template <class> class Atomic = std::atomic>
class SideSwitch {
 public:
  /// Setup.
  void start(PairSide side) noexcept {
    wanted_.store(side, std::memory_order_relaxed);
    active_.store(side, std::memory_order_relaxed);
    count_.store(0, std::memory_order_relaxed);
  }
  /// Any thread: hand on this side from the next cycle on.
  void want(PairSide side) noexcept { wanted_.store(side, std::memory_order_release); }
  /// Loop thread: takes up what is wanted. True: the side has changed.
  [[nodiscard]] bool advance() noexcept {
    const PairSide wanted = wanted_.load(std::memory_order_acquire);
    if (wanted == active_.load(std::memory_order_relaxed)) return false;
    active_.store(wanted, std::memory_order_relaxed);
    count_.fetch_add(1, std::memory_order_relaxed);
    return true;
  }
  /// Any thread.
  [[nodiscard]] PairSide active() const noexcept { return active_.load(std::memory_order_relaxed); }
  [[nodiscard]] std::uint64_t count() const noexcept { return count_.load(std::memory_order_relaxed); }

 private:
  Atomic<PairSide> wanted_{PairSide::real};
  Atomic<PairSide> active_{PairSide::real};
  Atomic<std::uint64_t> count_{0};
};

}  // namespace rigor
