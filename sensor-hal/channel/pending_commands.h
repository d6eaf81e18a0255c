// Commands that wait for their instants in virtual time, for stand-ins of devices.
#pragma once

#include <algorithm>
#include <vector>

#include "sensor-hal/channel/channel.h"

namespace rigor {

/// One thread.
class PendingCommands {
 public:
  static constexpr std::size_t kPlaces = 256;
  PendingCommands() { waiting_.reserve(kPlaces); }

  /// By t_effect, and of equal ones in the order in which they were given. Allocates nothing. False: it is
  /// full.
  [[nodiscard]] bool push(const Command& c) noexcept {
    if (waiting_.size() == kPlaces) return false;
    const auto place =
        std::upper_bound(waiting_.begin(), waiting_.end(), c,
                         [](const Command& a, const Command& b) { return a.t_effect < b.t_effect; });
    waiting_.insert(place, c);
    return true;
  }
  /// never() where none waits.
  [[nodiscard]] BenchTime next() const noexcept {
    return waiting_.empty() ? BenchTime::never() : waiting_.front().t_effect;
  }
  /// One must wait.
  [[nodiscard]] Command pop() noexcept {
    const Command c = waiting_.front();
    waiting_.erase(waiting_.begin());
    return c;
  }
  /// How many waited.
  std::size_t clear() noexcept {
    const std::size_t n = waiting_.size();
    waiting_.clear();
    return n;
  }

 private:
  std::vector<Command> waiting_;
};

}  // namespace rigor
