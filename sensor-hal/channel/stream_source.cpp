#include "sensor-hal/channel/stream_source.h"

#include <time.h>

#include <algorithm>
#include <limits>

namespace rigor {
namespace {
constexpr int kMaxNaps = 10'000;  // of 0.1 ms
}  // namespace

void StreamSource::open_stream(std::size_t slots, std::size_t slot_bytes, bool virtual_time) {
  ring_.reset();  // it may hold leases of the pool
  if (!pool_ || pool_->size() != slots || slot_bytes_ != slot_bytes) {
    std::erase_if(retired_, [](const auto& pool) { return pool->in_use() == 0; });
    if (pool_ && pool_->in_use() != 0) retired_.push_back(std::move(pool_));
    pool_ = make_sample_pool(slots, slot_bytes);
    slot_bytes_ = slot_bytes;
  }
  ring_ = std::make_unique<SpscRing<SampleLease>>(slots);
  lost_before_ = 0;
  naps_left_ = kMaxNaps;
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

SampleLease StreamSource::take_slot() noexcept {
  SampleLease slot = pool_->try_acquire();
  // In virtual time a slot that another thread (the recorder, a digest) is about to let go of is waited for,
  // as simulated sources do: what a run sees may not depend on when a busy machine gets to it. What waits
  // here to be polled comes free by no wait, nor does what a fault holds back on this very thread: each wait
  // in vain makes the next an eighth as long.
  if (!virtual_time_ || slot || ring_->size_approx() >= pool_->size()) return slot;
  for (int naps = 0; !slot && naps < naps_left_; ++naps) {
    const timespec nap{0, 100'000};
    nanosleep(&nap, nullptr);
    slot = pool_->try_acquire();
  }
  naps_left_ = slot ? kMaxNaps : std::max(1, naps_left_ / 8);
  return slot;
}

void StreamSource::hand_over(SampleLease&& lease) noexcept {
  health_.received.fetch_add(1, std::memory_order_relaxed);
  if (!lease) {
    health_.no_slot.fetch_add(1, std::memory_order_relaxed);
    ++lost_before_;
    return;
  }
  lease.edit().stamp.lost_before = lost_before_;
  if (ring_->try_push(std::move(lease))) {
    lost_before_ = 0;
  } else {
    health_.ring_full.fetch_add(1, std::memory_order_relaxed);
    ++lost_before_;
    lease.reset();
  }
}

void StreamSource::count_lost(std::uint64_t samples) noexcept {
  health_.lost.fetch_add(samples, std::memory_order_relaxed);
  const std::uint64_t most = std::numeric_limits<std::uint32_t>::max() - lost_before_;
  lost_before_ += static_cast<std::uint32_t>(std::min(samples, most));
}

}  // namespace rigor
