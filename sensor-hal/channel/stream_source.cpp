#include "sensor-hal/channel/stream_source.h"

#include <algorithm>
#include <limits>

namespace rigor {

void StreamSource::open_stream(std::size_t slots, std::size_t slot_bytes, bool virtual_time) {
  if (!pool_ || pool_->size() != slots || slot_bytes_ != slot_bytes) {
    pool_ = make_sample_pool(slots, slot_bytes);
    slot_bytes_ = slot_bytes;
  }
  ring_ = std::make_unique<SpscRing<SampleLease>>(slots);
  lost_before_ = 0;
  slot_wait_.begin(virtual_time);
  // Samples that lie in their info alone are copied by who keeps them.
  most_waiting_ = slot_bytes > 0 ? most_waiting(slots, virtual_time) : slots;
  virtual_time_ = virtual_time;
}

void StreamSource::close_stream() noexcept {
  SampleLease left;
  while (ring_ && ring_->try_pop(left)) {
  }
}

SampleLease StreamSource::poll(BenchTime now) noexcept {
  SampleLease lease;
  if (!ring_) return lease;
  if (virtual_time_) {
    const SampleLease* front = ring_->peek();
    if (!front || (*front)->stamp.t_release > now) return lease;
  }
  (void)ring_->try_pop(lease);
  return lease;
}

SampleSlot StreamSource::take_slot() noexcept {
  // What waits here to be polled comes free by no wait.
  if (ring_->size_approx() >= most_waiting_) return {};
  return slot_wait_.acquire(*pool_);
}

void StreamSource::hand_over(SampleSlot&& slot) noexcept {
  health_.received.fetch_add(1, std::memory_order_relaxed);
  if (!slot) {
    health_.no_slot.fetch_add(1, std::memory_order_relaxed);
    ++lost_before_;
    return;
  }
  slot->stamp.lost_before = lost_before_;
  if (ring_->size_approx() < most_waiting_ && ring_->try_push(std::move(slot))) {
    lost_before_ = 0;
  } else {
    health_.ring_full.fetch_add(1, std::memory_order_relaxed);
    ++lost_before_;
  }
}

void StreamSource::count_lost(std::uint64_t samples) noexcept {
  health_.lost.fetch_add(samples, std::memory_order_relaxed);
  const std::uint64_t most = std::numeric_limits<std::uint32_t>::max() - lost_before_;
  lost_before_ += static_cast<std::uint32_t>(std::min(samples, most));
}

}  // namespace rigor
