#include "drivers/gnss/gnss_time.h"

#include <array>
#include <cstdlib>

namespace rigor::gnss {
namespace {

constexpr std::int64_t kGpsEpochDays = 3657;  // 1980-01-06

constexpr std::int64_t floor_div(std::int64_t a, std::int64_t b) { return a / b - (a % b < 0 ? 1 : 0); }

}  // namespace

bool is_date(int year, int month, int day) noexcept {
  if (year < 1980 || year > 2199 || month < 1 || month > 12 || day < 1) return false;
  constexpr std::array<int, 12> kDays{31, 28, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31};
  const bool leap = (year % 4 == 0 && year % 100 != 0) || year % 400 == 0;
  return day <= kDays[static_cast<std::size_t>(month - 1)] + (month == 2 && leap ? 1 : 0);
}

std::int64_t days_from_date(int year, int month, int day) noexcept {
  const std::int64_t y = month <= 2 ? year - 1 : year;
  const std::int64_t era = floor_div(y, 400), yoe = y - era * 400;
  const std::int64_t doy = (153 * (month + (month > 2 ? -3 : 9)) + 2) / 5 + day - 1;
  return era * 146097 + yoe * 365 + yoe / 4 - yoe / 100 + doy - 719468;
}

RealtimeTime realtime_of(const UtcTime& t) noexcept {
  const std::int64_t seconds = ((days_from_date(t.year, t.month, t.day) * 24 + t.hour) * 60 + t.minute) * 60;
  return RealtimeTime((seconds + t.second) * kSecond_ns + t.nanosecond);
}

UtcTime utc_time(RealtimeTime t) noexcept {
  const std::int64_t days = floor_div(t.ns(), kDay_ns);
  const std::int64_t of_day = t.ns() - days * kDay_ns;
  const std::int64_t z = days + 719468, era = floor_div(z, 146097), doe = z - era * 146097;
  const std::int64_t yoe = (doe - doe / 1460 + doe / 36524 - doe / 146096) / 365;
  const std::int64_t doy = doe - (365 * yoe + yoe / 4 - yoe / 100), mp = (5 * doy + 2) / 153;
  UtcTime u;
  u.day = static_cast<int>(doy - (153 * mp + 2) / 5 + 1);
  u.month = static_cast<int>(mp < 10 ? mp + 3 : mp - 9);
  u.year = static_cast<int>(yoe + era * 400 + (u.month <= 2 ? 1 : 0));
  const std::int64_t s = of_day / kSecond_ns;
  u.hour = static_cast<int>(s / 3600), u.minute = static_cast<int>(s / 60 % 60),
  u.second = static_cast<int>(s % 60);
  u.nanosecond = of_day % kSecond_ns;
  return u;
}

GpsTime gps_time(RealtimeTime utc, int leap_seconds) noexcept {
  const std::int64_t ns = utc.ns() - kGpsEpochDays * kDay_ns + leap_seconds * kSecond_ns;
  const std::int64_t week = floor_div(ns, kWeek_ns);
  return {week, ns - week * kWeek_ns};
}

RealtimeTime utc_of_gps(GpsTime t, int leap_seconds) noexcept {
  return RealtimeTime(t.week * kWeek_ns + t.tow_ns + kGpsEpochDays * kDay_ns - leap_seconds * kSecond_ns);
}

std::optional<RealtimeTime> repaired_rollover(RealtimeTime utc, RealtimeTime now) noexcept {
  constexpr std::int64_t kCycle = 1024 * kWeek_ns, kNear = 2 * kDay_ns;
  const std::int64_t behind = (now - utc).ns();
  const std::int64_t cycles = (behind + kCycle / 2) / kCycle;
  if (cycles < 1 || std::llabs(behind - cycles * kCycle) > kNear) return {};
  return RealtimeTime(utc.ns() + cycles * kCycle);
}

std::int64_t Unwrapper::nearest(std::int64_t in_cycle_ns) const noexcept {
  const std::int64_t step = in_cycle_ns - (last_ns_ - floor_div(last_ns_, cycle_ns_) * cycle_ns_);
  return last_ns_ + (step > cycle_ns_ / 2    ? step - cycle_ns_
                     : step < -cycle_ns_ / 2 ? step + cycle_ns_
                                             : step);
}

std::int64_t Unwrapper::next(std::int64_t in_cycle_ns) noexcept {
  last_ns_ = any_ ? nearest(in_cycle_ns) : in_cycle_ns;
  any_ = true;
  return last_ns_;
}

}  // namespace rigor::gnss
