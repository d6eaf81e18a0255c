// The period of a rate that any fraction of whole numbers may be: 30, 29.97 or 60000/1001 a second.
//
//   const Period p = Period::of_rate(30, 1);
//   t0 + p * k            // instant k of the grid, rounded once: it never drifts
//   (t - t0) / p          // the last k whose instant is at or before t
//   p.ns()                // 33'333'333, the nearest whole number: a nominal value for timeouts and messages
//
//   k          0           1           2           3
//   exact      0      33333333.3  66666666.6  100000000   ns
//   p * k      0      33333333    66666667    100000000
//
// Instant k is floor(k·den·10⁹/num + 1/2) ns: to the nearest nanosecond, ties to the later one, for negative
// k as well, so that a shift by whole seconds' worth of instants changes nothing. Two neighbours are nominal
// periods apart to within 1 ns. All of it in integers of 128 bits: exact for as long as the result is in the
// range of a Duration (292 years), and at the end of that range beyond it.
//
// A Period is a Duration, its nominal one, wherever only that is asked for. Calls: any thread, wait-free, no
// allocation, but for those that read or write text.
#pragma once

#include <cstdint>
#include <limits>
#include <numeric>
#include <string>
#include <string_view>

#include "rt-core/result.h"
#include "rt-core/time.h"

namespace rigor {

class Period : public Duration {
 public:
  /// Aperiodic: 0 ns.
  constexpr Period() = default;
  /// A whole number of nanoseconds.
  constexpr Period(Duration whole) : Duration(whole), num_(kNsPerS), den_(whole.ns()), whole_(true) {
    reduce();
  }
  /// Of num/den a second, both from 1 to 10^18, and the rate from 1e-9 to 1e9.
  [[nodiscard]] static constexpr Period of_rate(std::int64_t num, std::int64_t den = 1) {
    Period p;
    p.num_ = num;
    p.den_ = den;
    p.reduce();
    const Int128 doubled = Int128(2) * p.den_ * kNsPerS;
    static_cast<Duration&>(p) =
        Duration(static_cast<std::int64_t>((doubled + p.num_) / (2 * Int128(p.num_))));
    p.whole_ = Int128(p.den_) * kNsPerS % p.num_ == 0;
    return p;
  }
  /// Of the simplest fraction that is this double: 29.97 is 2997/100, 1/0.03 is 100/3. For devices whose
  /// registers and options are doubles. Precondition: 1e-9 <= hz <= 1e9.
  [[nodiscard]] static Period of_hz(double hz);

  [[nodiscard]] constexpr double seconds() const {
    return whole_ ? Duration::seconds() : static_cast<double>(den_) / static_cast<double>(num_);
  }
  /// 0: aperiodic.
  [[nodiscard]] constexpr double hz() const {
    return ns() > 0 ? static_cast<double>(num_) / static_cast<double>(den_) : 0;
  }
  /// The rate in lowest terms.
  [[nodiscard]] constexpr std::int64_t rate_num() const { return num_; }
  [[nodiscard]] constexpr std::int64_t rate_den() const { return den_; }
  /// Whether it is a whole number of nanoseconds, as ns() says.
  [[nodiscard]] constexpr bool whole() const { return whole_; }
  /// Exactly, where == compares the nominal durations.
  [[nodiscard]] constexpr bool same_as(const Period& o) const { return num_ == o.num_ && den_ == o.den_; }

  /// Where instant k lies from instant 0.
  friend constexpr Duration operator*(const Period& p, std::int64_t k) { return p.instant(k); }
  friend constexpr Duration operator*(std::int64_t k, const Period& p) { return p.instant(k); }
  /// The last k with p * k <= d. Precondition: not aperiodic.
  friend constexpr std::int64_t operator/(Duration d, const Period& p) { return p.index_at(d); }
  /// The k whose instant is nearest to d, ties to the later. Precondition: not aperiodic.
  [[nodiscard]] constexpr std::int64_t nearest_index(Duration d) const {
    if (whole_) return floor_div(2 * Int128(d.ns()) + ns(), 2 * Int128(ns()));
    const Int128 period = Int128(den_) * kNsPerS;
    return floor_div(2 * Int128(d.ns()) * num_ + period, 2 * period);
  }
  /// The first k with p * k >= d, at least 0. Precondition: not aperiodic.
  [[nodiscard]] constexpr std::int64_t first_index_from(Duration d) const {
    return d.ns() <= 0 ? 0 : index_at(d - nanoseconds(1)) + 1;
  }
  Period& operator+=(Duration) = delete;
  Period& operator-=(Duration) = delete;

 private:
  __extension__ typedef __int128 Int128;  // NOLINT: `using` has no place for the word
  static constexpr std::int64_t kNsPerS = 1'000'000'000;

  static constexpr std::int64_t floor_div(Int128 a, Int128 b) {  // b > 0
    const Int128 q = a / b;
    return static_cast<std::int64_t>(a % b < 0 ? q - 1 : q);
  }
  constexpr void reduce() {
    if (den_ <= 0) return;
    const std::int64_t g = std::gcd(num_, den_);
    num_ /= g;
    den_ /= g;
  }
  [[nodiscard]] constexpr Duration instant(std::int64_t k) const {
    if (whole_) return Duration(ns() * k);
    constexpr Int128 kMost = std::numeric_limits<std::int64_t>::max();
    const Int128 span = Int128(k) * den_;  // in num_-ths of a second
    // What this bounds fits into 128 bits twice over.
    if (span > kMost / kNsPerS * num_) return Duration(std::numeric_limits<std::int64_t>::max());
    if (span < -(kMost / kNsPerS * num_)) return Duration(std::numeric_limits<std::int64_t>::min());
    return Duration(floor_div(2 * kNsPerS * span + num_, 2 * Int128(num_)));
  }
  [[nodiscard]] constexpr std::int64_t index_at(Duration d) const {
    if (whole_) return floor_div(d.ns(), ns());
    // floor(k·p + 1/2) <= d  ⇔  k < (d + 1/2)/p
    return floor_div((2 * Int128(d.ns()) + 1) * num_ - 1, 2 * Int128(den_) * kNsPerS);
  }

  std::int64_t num_ = kNsPerS, den_ = 0;  ///< instants per second
  bool whole_ = true;
};

/// "30", "29.97" (the exact decimal fraction), "1e3", "0x10" or "60000/1001", from 1e-9 to 1e9 a second, of
/// at most 18 digits. bad_input, without a place: what was expected, what came, what to do. Setup context.
[[nodiscard]] Result<Period> parse_rate(std::string_view text);
/// What parse_rate reads back: as a decimal where it has one of at most 9 places, else as a fraction.
[[nodiscard]] std::string rate_text(const Period& period);

}  // namespace rigor
