// Nanoseconds of UTC as builtin_interfaces/Time, and back. Any thread.
#pragma once

#include <algorithm>
#include <cstdint>
#include <limits>

#include "sensor-hal/record/ros2_messages.h"

namespace rigor::record {

/// Before 1970 the seconds are negative; what 32 bits do not hold (2038) is the limit.
[[nodiscard]] inline msg::Time to_time(std::int64_t utc_ns) {
  constexpr std::int64_t kSecond = 1'000'000'000;
  const std::int64_t sec = utc_ns / kSecond - (utc_ns % kSecond < 0 ? 1 : 0);
  using Limits = std::numeric_limits<std::int32_t>;
  return {static_cast<std::int32_t>(std::clamp<std::int64_t>(sec, Limits::min(), Limits::max())),
          static_cast<std::uint32_t>(utc_ns - sec * kSecond)};
}
[[nodiscard]] inline std::int64_t to_ns(const msg::Time& t) {
  return std::int64_t{t.sec} * 1'000'000'000 + t.nanosec;
}

}  // namespace rigor::record
