#include "rt-core/period.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <optional>
#include <utility>

namespace rigor {
namespace {

using std::string;
using std::string_view;

constexpr std::int64_t kMost = 1'000'000'000'000'000'000;  // of a numerator or denominator: 10^18
constexpr int kMostDigits = 18;

std::int64_t power_of_ten(int n) {
  std::int64_t p = 1;
  while (n-- > 0) p *= 10;
  return p;
}

string_view trimmed(string_view s) {
  while (!s.empty() && s.front() == ' ') s.remove_prefix(1);
  while (!s.empty() && s.back() == ' ') s.remove_suffix(1);
  return s;
}

bool all_digits(string_view s) {
  return !s.empty() && std::all_of(s.begin(), s.end(), [](char c) { return c >= '0' && c <= '9'; });
}

std::optional<std::int64_t> whole_number(string_view s, int base = 10) {
  std::int64_t n = 0;
  const auto [end, error] = std::from_chars(s.data(), s.data() + s.size(), n, base);
  if (error != std::errc{} || end != s.data() + s.size() || n < 0 || n > kMost) return {};
  return n;
}

struct Fraction {
  std::int64_t num = 0, den = 1;
};
enum class Read : std::uint8_t { good, not_one, too_long };

/// `digits[.digits][e[+-]digits]`, exactly.
Read read_decimal(string_view s, Fraction& out) {
  int exponent = 0;
  if (const auto e = s.find_first_of("eE"); e != string_view::npos) {
    string_view tail = s.substr(e + 1);
    const bool negative = !tail.empty() && tail.front() == '-';
    if (!tail.empty() && (tail.front() == '-' || tail.front() == '+')) tail.remove_prefix(1);
    if (!all_digits(tail)) return Read::not_one;
    const auto n = tail.size() > 6 ? std::nullopt : whole_number(tail);
    if (!n) return Read::too_long;
    exponent = static_cast<int>(negative ? -*n : *n);
    s = s.substr(0, e);
  }
  const auto dot = s.find('.');
  const string_view whole = s.substr(0, dot);
  const string_view part = dot == string_view::npos ? string_view{} : s.substr(dot + 1);
  if ((whole.empty() && part.empty()) || (!whole.empty() && !all_digits(whole)) ||
      (!part.empty() && !all_digits(part)))
    return Read::not_one;
  string digits = string(whole) + string(part);
  exponent -= static_cast<int>(part.size());
  digits.erase(0, std::min(digits.find_first_not_of('0'), digits.size()));
  while (!digits.empty() && digits.back() == '0') digits.pop_back(), ++exponent;
  if (digits.empty()) {
    out = {0, 1};
    return Read::good;
  }
  const auto length = static_cast<int>(digits.size());
  if (length > kMostDigits || exponent > kMostDigits - length || exponent < -kMostDigits)
    return Read::too_long;
  out.num = *whole_number(digits) * power_of_ten(std::max(exponent, 0));
  out.den = power_of_ten(std::max(-exponent, 0));
  return Read::good;
}

Read read_rate(string_view s, Fraction& out) {
  if (const auto slash = s.find('/'); slash != string_view::npos) {
    const string_view above = trimmed(s.substr(0, slash)), below = trimmed(s.substr(slash + 1));
    if (!all_digits(above) || !all_digits(below)) return Read::not_one;
    const auto num = whole_number(above), den = whole_number(below);
    if (!num || !den) return Read::too_long;
    out = {*num, *den};
    return Read::good;
  }
  if (s.starts_with('+')) s.remove_prefix(1);
  if (s.starts_with("0x") || s.starts_with("0o")) {
    const auto n = whole_number(s.substr(2), s[1] == 'x' ? 16 : 8);
    if (!n) return Read::not_one;
    out = {*n, 1};
    return Read::good;
  }
  return read_decimal(s, out);
}

}  // namespace

Period Period::of_hz(double hz) {
  // The convergents of its continued fraction, until one is the same double.
  double rest = hz;
  std::int64_t num = 1, den = 0, last_num = 0, last_den = 1;
  for (int i = 0; i < 64; ++i) {
    const double part = std::floor(rest);
    const double next_num = part * static_cast<double>(num) + static_cast<double>(last_num),
                 next_den = part * static_cast<double>(den) + static_cast<double>(last_den);
    if (!(next_num <= static_cast<double>(kMost)) || !(next_den <= static_cast<double>(kMost))) break;
    const auto a = static_cast<std::int64_t>(part);
    last_num = std::exchange(num, a * num + last_num);
    last_den = std::exchange(den, a * den + last_den);
    if (num > 0 && static_cast<double>(num) / static_cast<double>(den) == hz) return of_rate(num, den);
    if (rest == part) break;
    rest = 1 / (rest - part);
  }
  return seconds_from(1 / hz);
}

Result<Period> parse_rate(string_view text) {
  const string_view s = trimmed(text);
  const auto refuse = [&](const char* expected, const char* advice) {
    const string got = s.empty()       ? string("nothing")
                       : s.size() > 60 ? string(s.substr(0, 57)) + "..."
                                       : string(s);
    return fail(ErrorCode::bad_input, "", string("expected ") + expected + ", got " + got + "; " + advice);
  };
  constexpr const char* kForm = "a rate as a number or a fraction of whole numbers";
  Fraction f;
  switch (read_rate(s, f)) {
    case Read::not_one:
      return refuse(kForm, "write 30, 29.97 or 60000/1001");
    case Read::too_long:
      return refuse("a rate of at most 18 digits", "write a fraction, such as 100/3, or fewer digits");
    case Read::good:
      break;
  }
  if (f.den == 0) return refuse("a rate whose denominator is not 0", "write 30, 29.97 or 60000/1001");
  const double hz = static_cast<double>(f.num) / static_cast<double>(f.den);
  if (!(hz >= 1e-9 && hz <= 1e9))
    return refuse("a rate from 1e-9 to 1e9 a second", "leave the rate out where there is none");
  return Period::of_rate(f.num, f.den);
}

string rate_text(const Period& period) {
  if (period.ns() <= 0) return "0";
  const std::int64_t num = period.rate_num(), den = period.rate_den();
  for (int places = 0; places <= 9; ++places) {
    const std::int64_t power = power_of_ten(places);
    if (power % den != 0) continue;
    if (num > kMost / (power / den)) break;
    const string digits = std::to_string(num * (power / den));
    if (places == 0) return digits;
    const std::size_t point = static_cast<std::size_t>(places);
    const string padded = digits.size() > point ? digits : string(point + 1 - digits.size(), '0') + digits;
    return padded.substr(0, padded.size() - point) + "." + padded.substr(padded.size() - point);
  }
  return std::to_string(num) + "/" + std::to_string(den);
}

}  // namespace rigor
