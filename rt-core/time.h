// Time as Rigor counts it: int64 nanoseconds, tagged with the clock that they were read from.
//
// A camera stamps a frame in its own ticks, the kernel in CLOCK_REALTIME, the loop in bench time. Subtracting
// one from another is the classic silent error of a test bench, so each clock is a type of its own:
//
//   BenchTime t0 = ...;  MonotonicTime m = ...;
//   t0 + milliseconds(3)     // BenchTime
//   t0 - t0                  // Duration
//   t0 - m                   // does not compile: go through a ClockMap
//
// All functions here: any thread, wait-free, no allocation.
#pragma once

#include <compare>
#include <cstdint>
#include <ctime>
#include <limits>

namespace rigor {

/// A span of time in nanoseconds; may be negative.
class Duration {
 public:
  constexpr Duration() = default;
  constexpr explicit Duration(std::int64_t ns) : ns_(ns) {}
  [[nodiscard]] constexpr std::int64_t ns() const { return ns_; }
  [[nodiscard]] constexpr double seconds() const { return static_cast<double>(ns_) * 1e-9; }
  constexpr auto operator<=>(const Duration&) const = default;
  constexpr Duration operator-() const { return Duration(-ns_); }
  constexpr Duration& operator+=(Duration d) { return ns_ += d.ns_, *this; }
  constexpr Duration& operator-=(Duration d) { return ns_ -= d.ns_, *this; }
  friend constexpr Duration operator+(Duration a, Duration b) { return Duration(a.ns_ + b.ns_); }
  friend constexpr Duration operator-(Duration a, Duration b) { return Duration(a.ns_ - b.ns_); }
  friend constexpr Duration operator*(Duration a, std::int64_t k) { return Duration(a.ns_ * k); }
  friend constexpr Duration operator*(std::int64_t k, Duration a) { return Duration(a.ns_ * k); }
  friend constexpr std::int64_t operator/(Duration a, Duration b) { return a.ns_ / b.ns_; }
  friend constexpr Duration operator/(Duration a, std::int64_t k) { return Duration(a.ns_ / k); }

 private:
  std::int64_t ns_ = 0;
};

constexpr Duration nanoseconds(std::int64_t n) { return Duration(n); }
constexpr Duration microseconds(std::int64_t n) { return Duration(n * 1'000); }
constexpr Duration milliseconds(std::int64_t n) { return Duration(n * 1'000'000); }
constexpr Duration seconds(std::int64_t n) { return Duration(n * 1'000'000'000); }
/// Rounds to the nearest nanosecond. Precondition: |s| < 9.2e9.
constexpr Duration seconds_from(double s) {
  return Duration(static_cast<std::int64_t>(s * 1e9 + (s < 0 ? -0.5 : 0.5)));
}

/// An instant on the clock `Clock`, in nanoseconds since that clock's epoch.
template <class Clock>
class TimePoint {
 public:
  constexpr TimePoint() = default;
  constexpr explicit TimePoint(std::int64_t ns) : ns_(ns) {}
  [[nodiscard]] constexpr std::int64_t ns() const { return ns_; }
  constexpr auto operator<=>(const TimePoint&) const = default;
  static constexpr TimePoint never() { return TimePoint(std::numeric_limits<std::int64_t>::max()); }
  friend constexpr TimePoint operator+(TimePoint t, Duration d) { return TimePoint(t.ns_ + d.ns()); }
  friend constexpr TimePoint operator-(TimePoint t, Duration d) { return TimePoint(t.ns_ - d.ns()); }
  friend constexpr Duration operator-(TimePoint a, TimePoint b) { return Duration(a.ns_ - b.ns_); }

 private:
  std::int64_t ns_ = 0;
};

struct BenchClockTag {};      ///< wall runs: CLOCK_MONOTONIC; virtual runs: 0 at the first cycle
struct MonotonicClockTag {};  ///< CLOCK_MONOTONIC of this machine
struct RealtimeClockTag {};   ///< CLOCK_REALTIME of this machine: UTC nanoseconds since 1970
struct DeviceClockTag {};     ///< a device's own counter, already scaled to nanoseconds

using BenchTime = TimePoint<BenchClockTag>;
using MonotonicTime = TimePoint<MonotonicClockTag>;
using RealtimeTime = TimePoint<RealtimeClockTag>;
using DeviceTime = TimePoint<DeviceClockTag>;

[[nodiscard]] inline MonotonicTime monotonic_now() noexcept {
  timespec ts{};
  clock_gettime(CLOCK_MONOTONIC, &ts);
  return MonotonicTime(ts.tv_sec * 1'000'000'000 + ts.tv_nsec);
}
/// Bench time of a wall-clock run.
[[nodiscard]] inline BenchTime bench_now() noexcept { return BenchTime(monotonic_now().ns()); }
[[nodiscard]] inline RealtimeTime realtime_now() noexcept {
  timespec ts{};
  clock_gettime(CLOCK_REALTIME, &ts);
  return RealtimeTime(ts.tv_sec * 1'000'000'000 + ts.tv_nsec);
}

}  // namespace rigor
