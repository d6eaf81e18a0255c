// Preallocated slots: written by one owner, then read through leases that share them.
//
//   WritableSlot<T, Atomic> slot = pool.try_acquire();     unique and move-only: its holder alone reads and
//   writes slot->stamp = …; Lease<T> lease = std::move(slot);              published: read-only, shared by
//   copying Lease<T> other = lease;                        loop, application, recorder if (WritableSlot<T,
//   Atomic> again = lease.take_back()) the sole holder may write once more, before it shares it
//
// Nobody copies an image, nobody frees memory: when the last lease of a slot is dropped, the slot is free
// again. The count of a slot's users is the whole bookkeeping: there is no free list, so no ABA problem and
// nothing to lock.
//
// What a worker fills later than it was queued travels to the worker as a WritableSlot and comes back as a
// Lease, so that nobody can read what is being written.
//
// A pool may be destroyed before its leases. The slots then stay until the last of them is let go of, and the
// thread that does that frees their memory. So destroy a pool in setup context, and with leases outstanding
// only where the last of them will not be dropped by a loop that is running: that loop would free memory.
//
// `Atomic` is std::atomic; tests put their model of memory in its place (tests/rt-core/lock_free_test.cpp).
//
// Memory order. Each user of a slot leaves with release. Three others then need to see all of its accesses,
// and each acquires: who takes the slot again (try_acquire), who becomes its writer again (take_back), and
// who frees the memory (leave, forget).
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <utility>

namespace rigor {

template <class T, template <class> class Atomic = std::atomic>
class Pool;
template <class T, template <class> class Atomic = std::atomic>
class Lease;

namespace pool_detail {

/// The slots of one pool. Deletes itself once the pool and every user of a slot are gone.
template <class T, template <class> class Atomic>
class Storage {
 public:
  // The users of a slot, in one word: leases (a writable slot counts as one), holds, and a bit that is set
  // when the pool is destroyed.
  static constexpr std::uint32_t kLease = 1, kAllLeases = (1u << 20) - 1, kHold = 1u << 20,
                                 kPoolGone = 1u << 31;
  struct Slot {
    Atomic<std::uint32_t> users{0};
    Storage* storage = nullptr;
    T value{};
  };

  explicit Storage(std::size_t size) : remaining_(size + 1), slots(std::make_unique<Slot[]>(size)) {
    for (std::size_t i = 0; i < size; ++i) slots[i].storage = this;
  }

  static void enter(Slot& slot, std::uint32_t use) noexcept {
    slot.users.fetch_add(use, std::memory_order_relaxed);  // who copies is a user already
  }
  static void leave(Slot& slot, std::uint32_t use) noexcept {
    // Acquire, because the last user passes on to the memory's end what all users before it did.
    if (slot.users.fetch_sub(use, std::memory_order_acq_rel) - use == kPoolGone) slot.storage->forget(1);
  }
  /// `n` of the slots and the pool will not be used any more.
  void forget(std::size_t n) noexcept {
    if (remaining_.fetch_sub(n, std::memory_order_acq_rel) == n) delete this;
  }

 private:
  Atomic<std::size_t> remaining_;  // touched only once the pool is gone

 public:
  std::unique_ptr<Slot[]> slots;
};

}  // namespace pool_detail

/// The only access to one slot of a Pool, to write to it. One thread at a time. Move and destroy: wait-free,
/// no allocation. Moved into a Lease it is published; destroyed before that, the slot is free again.
template <class T, template <class> class Atomic = std::atomic>
class WritableSlot {
 public:
  WritableSlot() noexcept = default;
  WritableSlot(WritableSlot&& o) noexcept : slot_(std::exchange(o.slot_, nullptr)) {}
  WritableSlot& operator=(WritableSlot&& o) noexcept {
    WritableSlot taken(std::move(o));
    std::swap(slot_, taken.slot_);
    return *this;
  }
  ~WritableSlot() { reset(); }

  void reset() noexcept {
    if (auto* slot = std::exchange(slot_, nullptr)) Storage::leave(*slot, Storage::kLease);
  }
  [[nodiscard]] explicit operator bool() const noexcept { return slot_ != nullptr; }
  [[nodiscard]] T& operator*() noexcept { return slot_->value; }
  [[nodiscard]] const T& operator*() const noexcept { return slot_->value; }
  [[nodiscard]] T* operator->() noexcept { return &slot_->value; }
  [[nodiscard]] const T* operator->() const noexcept { return &slot_->value; }

 private:
  friend class Pool<T, Atomic>;
  friend class Lease<T, Atomic>;
  using Storage = pool_detail::Storage<T, Atomic>;
  explicit WritableSlot(typename Storage::Slot* slot) noexcept : slot_(slot) {}
  typename Storage::Slot* slot_ = nullptr;
};

/// Keeps a slot from being taken again, and gives no access to what is in it. Any thread, wait-free.
template <class T, template <class> class Atomic = std::atomic>
class SlotHold {
 public:
  SlotHold() noexcept = default;
  SlotHold(SlotHold&& o) noexcept : slot_(std::exchange(o.slot_, nullptr)) {}
  SlotHold& operator=(SlotHold&& o) noexcept {
    SlotHold taken(std::move(o));
    std::swap(slot_, taken.slot_);
    return *this;
  }
  ~SlotHold() {
    if (slot_) Storage::leave(*slot_, Storage::kHold);
  }

 private:
  friend class Lease<T, Atomic>;
  using Storage = pool_detail::Storage<T, Atomic>;
  explicit SlotHold(typename Storage::Slot* slot) noexcept : slot_(slot) {}
  typename Storage::Slot* slot_ = nullptr;
};

/// Shared reading of one slot of a Pool. Copy, move and destroy: any thread, wait-free, no allocation.
template <class T, template <class> class Atomic>
class Lease {
 public:
  Lease() noexcept = default;
  /// Publishes what was written.
  Lease(WritableSlot<T, Atomic>&& slot) noexcept : slot_(std::exchange(slot.slot_, nullptr)) {}
  Lease(const Lease& o) noexcept : slot_(o.slot_) {
    if (slot_) Storage::enter(*slot_, Storage::kLease);
  }
  Lease(Lease&& o) noexcept : slot_(std::exchange(o.slot_, nullptr)) {}
  Lease& operator=(Lease o) noexcept {
    std::swap(slot_, o.slot_);
    return *this;
  }
  ~Lease() { reset(); }

  void reset() noexcept {
    if (auto* slot = std::exchange(slot_, nullptr)) Storage::leave(*slot, Storage::kLease);
  }
  [[nodiscard]] explicit operator bool() const noexcept { return slot_ != nullptr; }
  [[nodiscard]] const T& operator*() const noexcept { return slot_->value; }
  [[nodiscard]] const T* operator->() const noexcept { return &slot_->value; }
  [[nodiscard]] bool same_as(const Lease& o) const noexcept { return slot_ == o.slot_; }

  /// For the only holder, to write again; this lease is empty then. With another lease of the same slot the
  /// answer is empty and this lease as before. A count of one cannot grow meanwhile: only a holder copies.
  [[nodiscard]] WritableSlot<T, Atomic> take_back() noexcept {
    if (!slot_ || (slot_->users.load(std::memory_order_acquire) & Storage::kAllLeases) != Storage::kLease)
      return {};
    return WritableSlot<T, Atomic>(std::exchange(slot_, nullptr));
  }
  /// Of a lease that is not empty. A hold does not count as a holder in `take_back`. At most 1023 of a slot.
  [[nodiscard]] SlotHold<T, Atomic> hold() const noexcept {
    Storage::enter(*slot_, Storage::kHold);
    return SlotHold<T, Atomic>(slot_);
  }

 private:
  using Storage = pool_detail::Storage<T, Atomic>;
  typename Storage::Slot* slot_ = nullptr;
};

/// A fixed number of slots. Construction and destruction: setup context. `try_acquire`: one producer thread
/// at a time, wait-free (bounded by the number of slots), no allocation.
template <class T, template <class> class Atomic>
class Pool {
 public:
  explicit Pool(std::size_t slots) : size_(slots), storage_(new Storage(slots)) {}
  Pool(const Pool&) = delete;
  Pool& operator=(const Pool&) = delete;
  ~Pool() {
    std::size_t unused = 1;  // the pool itself
    for (std::size_t i = 0; i < size_; ++i)
      unused += storage_->slots[i].users.fetch_or(Storage::kPoolGone, std::memory_order_acquire) == 0;
    storage_->forget(unused);  // releases what this thread did
  }

  /// Empty when every slot is in use.
  [[nodiscard]] WritableSlot<T, Atomic> try_acquire() noexcept {
    for (std::size_t i = 0; i < size_; ++i) {
      auto& slot = storage_->slots[next_];
      next_ = next_ + 1 == size_ ? 0 : next_ + 1;
      if (slot.users.load(std::memory_order_acquire) == 0) {
        slot.users.store(Storage::kLease, std::memory_order_relaxed);
        return WritableSlot<T, Atomic>(&slot);
      }
    }
    return {};
  }
  /// Setup only: visit every slot, to give it its memory.
  template <class F>
  void for_each(F&& f) {
    for (std::size_t i = 0; i < size_; ++i) f(storage_->slots[i].value);
  }
  [[nodiscard]] std::size_t size() const noexcept { return size_; }
  /// Slots in use at this instant; a snapshot for health reports.
  [[nodiscard]] std::size_t in_use() const noexcept {
    std::size_t n = 0;
    for (std::size_t i = 0; i < size_; ++i)
      n += storage_->slots[i].users.load(std::memory_order_relaxed) != 0;
    return n;
  }

 private:
  using Storage = pool_detail::Storage<T, Atomic>;
  std::size_t size_;
  std::size_t next_ = 0;
  Storage* storage_;
};

}  // namespace rigor
