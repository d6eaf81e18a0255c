// Preallocated slots and the leases that share them.
//
// A driver thread takes a slot, fills it, and hands the lease to the loop; the loop hands copies to the
// application and to the recorder. Nobody copies an image, nobody frees memory: the last lease that goes out
// of scope makes the slot free again. The reference count of a slot is the whole bookkeeping: there is no
// free list, so no ABA problem and nothing to lock. Memory order: the count falls with release and is read
// with acquire when a slot is taken, so the new owner sees every access of the last one.
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <utility>

namespace rigor {

template <class T>
class Pool;

/// Shared ownership of one slot of a Pool. Copy, move and destroy: any thread, wait-free, no allocation.
/// The pool outlives its leases.
template <class T>
class Lease {
 public:
  Lease() noexcept = default;
  Lease(const Lease& o) noexcept : slot_(o.slot_) {
    if (slot_) slot_->refs.fetch_add(1, std::memory_order_relaxed);
  }
  Lease(Lease&& o) noexcept : slot_(std::exchange(o.slot_, nullptr)) {}
  Lease& operator=(Lease o) noexcept {
    std::swap(slot_, o.slot_);
    return *this;
  }
  ~Lease() { reset(); }

  void reset() noexcept {
    if (auto* slot = std::exchange(slot_, nullptr)) slot->refs.fetch_sub(1, std::memory_order_release);
  }
  [[nodiscard]] explicit operator bool() const noexcept { return slot_ != nullptr; }
  [[nodiscard]] const T& operator*() const noexcept { return slot_->value; }
  [[nodiscard]] const T* operator->() const noexcept { return &slot_->value; }
  /// Write access: only for the thread that took the slot, before it hands the lease on.
  [[nodiscard]] T& edit() const noexcept { return slot_->value; }
  [[nodiscard]] bool same_as(const Lease& o) const noexcept { return slot_ == o.slot_; }

 private:
  friend class Pool<T>;
  struct Slot {
    std::atomic<std::uint32_t> refs{0};
    T value{};
  };
  explicit Lease(Slot* slot) noexcept : slot_(slot) {}
  Slot* slot_ = nullptr;
};

/// A fixed number of slots. Construction: setup context, allocates. `try_acquire`: one producer thread at a
/// time, wait-free (bounded by the number of slots), no allocation.
template <class T>
class Pool {
 public:
  explicit Pool(std::size_t slots)
      : size_(slots), slots_(std::make_unique<typename Lease<T>::Slot[]>(slots)) {}

  /// An empty lease when every slot is held.
  [[nodiscard]] Lease<T> try_acquire() noexcept {
    for (std::size_t i = 0; i < size_; ++i) {
      auto& slot = slots_[next_];
      next_ = next_ + 1 == size_ ? 0 : next_ + 1;
      if (slot.refs.load(std::memory_order_acquire) == 0) {
        slot.refs.store(1, std::memory_order_relaxed);
        return Lease<T>(&slot);
      }
    }
    return {};
  }
  /// Setup only: visit every slot, to give it its memory.
  template <class F>
  void for_each(F&& f) {
    for (std::size_t i = 0; i < size_; ++i) f(slots_[i].value);
  }
  [[nodiscard]] std::size_t size() const noexcept { return size_; }
  /// Slots held at this instant; a snapshot for health reports.
  [[nodiscard]] std::size_t in_use() const noexcept {
    std::size_t n = 0;
    for (std::size_t i = 0; i < size_; ++i) n += slots_[i].refs.load(std::memory_order_relaxed) != 0;
    return n;
  }

 private:
  std::size_t size_;
  std::size_t next_ = 0;
  std::unique_ptr<typename Lease<T>::Slot[]> slots_;
};

}  // namespace rigor
