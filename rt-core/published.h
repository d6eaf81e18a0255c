// A value that one thread replaces now and then and any thread reads at any time.
//
// A plain seqlock has a trap on a real-time machine: a FIFO thread that reads while the writer is preempted
// in the middle of its write, on the same CPU, spins for ever. Here the writer fills a slot that nobody is
// pointed to and then points to it; a reader repeats only if the writer published kSlots − 1 times during the
// read. A reader that is overtaken so may get the value that is just about to be published, and in its next
// read once more the one before.
//
// Memory order: words are stored with release and loaded with acquire, so a reader that sees a word of a
// newer write also sees, on its second look, the odd sequence number that came before it.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <cstring>
#include <type_traits>

namespace rigor {

/// `Atomic` is std::atomic; tests put their model of memory in its place (tests/rt-core/lock_free_test.cpp).
template <class T, template <class> class Atomic = std::atomic>
class Published {
  static_assert(std::is_trivially_copyable_v<T>,
                "a torn copy is made and thrown away: T may not own anything");

 public:
  Published() noexcept { store(T{}); }

  /// One writer thread; wait-free, no allocation.
  void store(const T& value) noexcept {
    const std::uint32_t next = (current_.load(std::memory_order_relaxed) + 1) % kSlots;
    Slot& slot = slots_[next];
    const std::uint64_t s = slot.sequence.load(std::memory_order_relaxed);
    slot.sequence.store(s + 1, std::memory_order_relaxed);
    std::array<std::uint64_t, kWords> words{};
    std::memcpy(words.data(), &value, sizeof(T));
    for (std::size_t i = 0; i < kWords; ++i) slot.words[i].store(words[i], std::memory_order_release);
    slot.sequence.store(s + 2, std::memory_order_release);
    current_.store(next, std::memory_order_release);
  }
  /// Any thread; never blocked by a writer that is preempted, no allocation.
  [[nodiscard]] T load() const noexcept {
    std::array<std::uint64_t, kWords> words;
    for (;;) {
      const Slot& slot = slots_[current_.load(std::memory_order_acquire)];
      const std::uint64_t before = slot.sequence.load(std::memory_order_acquire);
      for (std::size_t i = 0; i < kWords; ++i) words[i] = slot.words[i].load(std::memory_order_acquire);
      if ((before & 1) == 0 && slot.sequence.load(std::memory_order_relaxed) == before) break;
    }
    T value;
    std::memcpy(static_cast<void*>(&value), words.data(), sizeof(T));
    return value;
  }

 private:
  static constexpr std::uint32_t kSlots = 4;
  static constexpr std::size_t kWords = (sizeof(T) + 7) / 8;
  struct Slot {
    Atomic<std::uint64_t> sequence{0};
    std::array<Atomic<std::uint64_t>, kWords> words{};
  };
  std::array<Slot, kSlots> slots_{};
  Atomic<std::uint32_t> current_{0};
};

}  // namespace rigor
