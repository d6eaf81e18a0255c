// When a device that went away is tried again: at once, then after pauses that double from 50 ms to 2 s.
#pragma once

#include <algorithm>

#include "rt-core/time.h"

namespace rigor {

/// One thread.
class Backoff {
 public:
  static constexpr Duration kFirst = milliseconds(50), kLongest = seconds(2);

  [[nodiscard]] bool due(MonotonicTime now) const noexcept { return now >= next_; }
  /// When the next attempt is due.
  [[nodiscard]] MonotonicTime next() const noexcept { return next_; }
  void failed(MonotonicTime now) noexcept {
    next_ = now + pause_;
    pause_ = std::min(pause_ * 2, kLongest);
  }
  /// The device is there, or has only just gone: the next attempt is due at once.
  void reset() noexcept {
    next_ = {};
    pause_ = kFirst;
  }

 private:
  MonotonicTime next_;
  Duration pause_ = kFirst;
};

}  // namespace rigor
