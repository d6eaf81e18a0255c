// What sources with a device behind them share: slots for samples, the ring to the loop, and the accounting
// of what is lost on the way.
//
//   do_arm    open_stream(slots, bytes, context.virtual_time)
//   thread    SampleSlot slot = take_slot();             // may be empty: all slots are held
//             if (slot) { fill slot: info, memory, stamp … }
//             hand_over(std::move(slot));                // empty: the sample is counted and lost
//   do_stop   join the thread, then close_stream()
//
// A device that writes to memory by itself is lent slots before their samples come: lend_slot() in place of
// take_slot(), and for_each_slot() once to make the memory known to it.
//
// In virtual time the loop's own thread is the producer, in complete_until.
#pragma once

#include <memory>

#include "rt-core/spsc_ring.h"
#include "sensor-hal/channel/channel.h"
#include "sensor-hal/channel/slot_wait.h"

namespace rigor {

class StreamSource : public Source {
 public:
  /// In virtual time only what is released by `now`; on the wall clock what has come (its port waits for the
  /// release).
  [[nodiscard]] SampleLease poll(BenchTime now) noexcept final;

 protected:
  /// Setup thread. Takes memory for `slots` samples of `slot_bytes` each.
  void open_stream(std::size_t slots, std::size_t slot_bytes, bool virtual_time);
  /// Setup thread, no producer is running: what nobody polled is given back.
  void close_stream() noexcept;

  /// Producer thread; wait-free, in virtual time waiting. Empty when every slot stays held.
  [[nodiscard]] SampleSlot take_slot() noexcept;
  /// Setup thread, after open_stream(): `f(Sample&)` for each slot, always in the same order.
  template <class F>
  void for_each_slot(F&& f) {
    pool_->for_each(std::forward<F>(f));
  }
  /// Producer thread; wait-free. A slot whose sample has not come yet; empty when all are held.
  [[nodiscard]] SampleSlot lend_slot() noexcept { return pool_->try_acquire(); }
  /// Producer thread; wait-free. Counts a sample that came, writes its `lost_before`, and publishes it for
  /// the loop. An empty slot is a sample that came and for which there was no slot. A sample is dropped where
  /// as many as may wait are waiting for the loop.
  void hand_over(SampleSlot&& slot) noexcept;
  /// Producer thread: samples that are known to have been lost before they came here.
  void count_lost(std::uint64_t samples) noexcept;

 private:
  std::unique_ptr<SamplePool> pool_;
  std::size_t slot_bytes_ = 0;
  std::unique_ptr<SpscRing<SampleLease>> ring_;
  std::uint32_t lost_before_ = 0;
  SlotWait slot_wait_;
  std::size_t most_waiting_ = 0;
  bool virtual_time_ = false;
};

}  // namespace rigor
