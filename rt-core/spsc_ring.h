// One producer thread, one consumer thread, a fixed number of places: how device threads and the loop hand
// things over.
#pragma once

#include <readerwriterqueue/readerwriterqueue.h>

#include <cstddef>
#include <type_traits>
#include <utility>

#include "rt-core/sanitizers.h"

#if defined(RIGOR_THREAD_SANITIZER)
#include <sanitizer/tsan_interface.h>
#endif

namespace rigor {

/// Wait-free on both sides; never allocates after construction (moodycamel's try_* calls do not grow the
/// queue).
template <class T>
class SpscRing {
 public:
  /// Setup: room for at least `places` values. Each place is written once, so that the loop meets no page
  /// fault there.
  explicit SpscRing(std::size_t places) : queue_(places) {
    if constexpr (std::is_default_constructible_v<T>) {
      while (queue_.try_enqueue(T{})) {
      }
      while (queue_.pop()) {
      }
    }
  }
  /// Producer thread. False when full; the value is then untouched.
  [[nodiscard]] bool try_push(T&& value) noexcept {
    announce();
    return queue_.try_enqueue(std::move(value));
  }
  [[nodiscard]] bool try_push(const T& value) noexcept {
    announce();
    return queue_.try_enqueue(value);
  }
  /// Consumer thread. False when empty.
  [[nodiscard]] bool try_pop(T& value) noexcept { return queue_.try_dequeue(value) && observe(); }
  /// Consumer thread. The oldest element, or nullptr.
  [[nodiscard]] T* peek() noexcept {
    T* front = queue_.peek();
    if (front) observe();
    return front;
  }
  void drop_front() noexcept { queue_.pop(); }
  [[nodiscard]] std::size_t size_approx() const noexcept { return queue_.size_approx(); }

 private:
  // The queue publishes with fences, which ThreadSanitizer does not see: it is told of the order that they
  // give, or everything that is handed over through a ring would look like a race.
  void announce() noexcept {
#if defined(RIGOR_THREAD_SANITIZER)
    __tsan_release(this);
#endif
  }
  bool observe() noexcept {
#if defined(RIGOR_THREAD_SANITIZER)
    __tsan_acquire(this);
#endif
    return true;
  }
  moodycamel::ReaderWriterQueue<T> queue_;
};

}  // namespace rigor
