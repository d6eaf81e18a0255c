// Calendars of satellite receivers: UTC dates, GPS weeks, and dates that are 1024 weeks behind.
#pragma once

#include <cstdint>
#include <optional>

#include "rt-core/time.h"

namespace rigor::gnss {

inline constexpr std::int64_t kSecond_ns = 1'000'000'000;
inline constexpr std::int64_t kWeek_ns = 604'800'000'000'000, kDay_ns = 86'400'000'000'000;

/// Of the Gregorian calendar, 1980 to 2199.
[[nodiscard]] bool is_date(int year, int month, int day) noexcept;
/// Days since 1970-01-01. Source: H. Hinnant, "chrono-compatible low-level date algorithms".
[[nodiscard]] std::int64_t days_from_date(int year, int month, int day) noexcept;

/// UTC as receivers write it.
struct UtcTime {
  int year = 1970, month = 1, day = 1, hour = 0, minute = 0, second = 0;
  std::int64_t nanosecond = 0;
};
/// A leap second (23:59:60) is the same as 00:00:00 of the next day in nanoseconds since 1970, which count
/// none.
[[nodiscard]] RealtimeTime realtime_of(const UtcTime& t) noexcept;
[[nodiscard]] UtcTime utc_time(RealtimeTime t) noexcept;

/// GPS time of week of an instant, and the week; `leap_seconds`: GPS time less UTC (18 since 2017).
struct GpsTime {
  std::int64_t week = 0;
  std::int64_t tow_ns = 0;
};
[[nodiscard]] GpsTime gps_time(RealtimeTime utc, int leap_seconds) noexcept;
[[nodiscard]] RealtimeTime utc_of_gps(GpsTime t, int leap_seconds) noexcept;

/// A receiver with old firmware counts weeks modulo 1024, so its dates are a multiple of 1024 weeks behind:
/// the date with that added, where it then lies within two days of `now`. Empty: the date is not of that
/// kind.
[[nodiscard]] std::optional<RealtimeTime> repaired_rollover(RealtimeTime utc, RealtimeTime now) noexcept;

/// Counts on over the ends of a cycle: time of week, or of day.
class Unwrapper {
 public:
  explicit Unwrapper(std::int64_t cycle_ns) : cycle_ns_(cycle_ns) {}
  /// The nearest instant to the one before that has this place in its cycle.
  std::int64_t next(std::int64_t in_cycle_ns) noexcept;
  /// The same without moving on. Precondition: any().
  [[nodiscard]] std::int64_t nearest(std::int64_t in_cycle_ns) const noexcept;
  [[nodiscard]] bool any() const noexcept { return any_; }
  void reset() noexcept { any_ = false; }

 private:
  std::int64_t cycle_ns_, last_ns_ = 0;
  bool any_ = false;
};

}  // namespace rigor::gnss
