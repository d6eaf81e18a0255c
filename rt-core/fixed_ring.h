// A queue of fixed capacity for one thread at a time: values come at the back and go at the front, in places
// that are taken once. Between two threads: rt-core/spsc_ring.h.
#pragma once

#include <array>
#include <cassert>
#include <cstddef>
#include <type_traits>
#include <utility>
#include <vector>

namespace rigor {

/// `kCapacity` places within the object; 0: as many as the constructor is told, taken then. Nothing else
/// allocates. T is default-constructible. A place that was left holds T{}, so that what its value held (a
/// lease, memory) is let go at once.
template <class T, std::size_t kCapacity = 0>
class FixedRing {
 public:
  FixedRing() = default;
  explicit FixedRing(std::size_t capacity) requires(kCapacity == 0) : places_(capacity) {}
  ~FixedRing() = default;
  FixedRing(const FixedRing&) = default;
  FixedRing& operator=(const FixedRing&) = default;
  /// What is moved from is empty; without places of its own it has none left.
  FixedRing(FixedRing&& other) noexcept
      : places_(std::move(other.places_)),
        first_(std::exchange(other.first_, 0)),
        size_(std::exchange(other.size_, 0)) {}
  FixedRing& operator=(FixedRing&& other) noexcept {
    places_ = std::move(other.places_);
    first_ = std::exchange(other.first_, 0);
    size_ = std::exchange(other.size_, 0);
    return *this;
  }

  [[nodiscard]] std::size_t capacity() const noexcept { return places_.size(); }
  [[nodiscard]] std::size_t size() const noexcept { return size_; }
  [[nodiscard]] bool empty() const noexcept { return size_ == 0; }
  [[nodiscard]] bool full() const noexcept { return size_ == capacity(); }

  /// Precondition: not full.
  T& push_back(T value) noexcept {
    assert(!full());
    T& place = places_[place_of(size_++)];
    place = std::move(value);
    return place;
  }
  /// Where it is full, the oldest goes. Precondition: there is a place.
  T& push_newest(T value) noexcept {
    if (full()) (void)pop_front();
    return push_back(std::move(value));
  }
  /// Precondition: not empty.
  T pop_front() noexcept {
    assert(!empty());
    T value = std::move(places_[first_]);
    if constexpr (!std::is_trivially_destructible_v<T>) places_[first_] = T{};
    first_ = place_of(1);
    --size_;
    return value;
  }
  void clear() noexcept {
    if constexpr (std::is_trivially_destructible_v<T>) {
      first_ = size_ = 0;
    } else {
      while (!empty()) (void)pop_front();
    }
  }

  /// Counted from the oldest. Precondition: i < size().
  [[nodiscard]] T& operator[](std::size_t i) noexcept {
    assert(i < size_);
    return places_[place_of(i)];
  }
  [[nodiscard]] const T& operator[](std::size_t i) const noexcept {
    assert(i < size_);
    return places_[place_of(i)];
  }
  /// The oldest. Precondition: not empty.
  [[nodiscard]] T& front() noexcept { return (*this)[0]; }
  [[nodiscard]] const T& front() const noexcept { return (*this)[0]; }
  /// The newest. Precondition: not empty.
  [[nodiscard]] T& back() noexcept { return (*this)[size_ - 1]; }
  [[nodiscard]] const T& back() const noexcept { return (*this)[size_ - 1]; }

 private:
  [[nodiscard]] std::size_t place_of(std::size_t i) const noexcept {
    const std::size_t place = first_ + i;
    return place < capacity() ? place : place - capacity();
  }

  std::conditional_t<kCapacity == 0, std::vector<T>, std::array<T, kCapacity>> places_{};
  std::size_t first_ = 0, size_ = 0;
};

}  // namespace rigor
