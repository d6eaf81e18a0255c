// The wait for a slot in virtual time.
//
// What another thread (the recorder, a digest) is about to let go of is waited for, so that what a run sees
// does not depend on when a busy machine gets to it. What is held on the waiting thread itself comes free by
// no wait: each wait in vain makes the next an eighth as long. On the wall clock nothing is waited for.
//
// And of a channel's slots those that a recorder leaves to the loop, however slow its disk is. On the wall
// clock no more samples may wait for a loop that does not poll than a recorder can take at once when it does:
// else the application would see what the recording lacks.
#pragma once

#include <time.h>

#include <algorithm>

#include "sensor-hal/channel/channel.h"

namespace rigor {

inline constexpr std::size_t kSlotsForTheLoop = 6;

/// Of `slots`, how many may hold samples that wait to be polled.
[[nodiscard]] constexpr std::size_t most_waiting(std::size_t slots, bool virtual_time) noexcept {
  return virtual_time || slots <= kSlotsForTheLoop + 4 ? slots : slots - kSlotsForTheLoop;
}

class SlotWait {
 public:
  void begin(bool virtual_time) noexcept {
    virtual_time_ = virtual_time;
    naps_left_ = kMostNaps;
  }

  /// The thread that fills slots. Empty when every slot stays held.
  [[nodiscard]] SampleSlot acquire(SamplePool& pool) noexcept {
    SampleSlot slot = pool.try_acquire();
    if (slot || !virtual_time_) return slot;
    for (int naps = 0; !slot && naps < naps_left_; ++naps) {
      const timespec nap{0, 100'000};
      nanosleep(&nap, nullptr);
      slot = pool.try_acquire();
    }
    naps_left_ = slot ? kMostNaps : std::max(1, naps_left_ / 8);
    return slot;
  }

 private:
  static constexpr int kMostNaps = 10'000;  // of 0.1 ms
  int naps_left_ = kMostNaps;
  bool virtual_time_ = false;
};

}  // namespace rigor
