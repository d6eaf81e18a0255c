// Which sample belongs to which trigger, where a device has no clock of its own: a trigger causes the sample
// that arrives next.
//
//   triggers   |         |         |         |
//   arrivals      o         o                   o        the third trigger got none
//                 └ latency = arrival − the trigger before it
//
// That holds where the latency is shorter than the time between two triggers. Whether it is, the arrivals
// alone cannot tell: whoever calls says what the shortest time was.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

namespace rigor::calibration {

struct TriggerMatch {
  struct Pair {
    std::size_t trigger, sample;  ///< indices of what was given
  };
  std::vector<Pair> pairs;
  std::size_t without_sample = 0;   ///< triggers, the last one apart, whose sample may come after the end
  std::size_t without_trigger = 0;  ///< samples after the first trigger that are not the first since one
  std::int64_t minimum_interval_ns = 0;  ///< between two triggers; 0: there are not two
};

/// Both increasing, in nanoseconds of one clock. Any thread; allocates.
[[nodiscard]] TriggerMatch match_triggers(std::span<const std::int64_t> triggers_ns,
                                          std::span<const std::int64_t> arrivals_ns);

}  // namespace rigor::calibration
