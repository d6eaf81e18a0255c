#include "sensor-hal/config/unit_limits.h"

#include <algorithm>
#include <cmath>

namespace rigor::config {
namespace {

struct UnitLimit {
  std::string_view unit;
  double most;
};

/// Plain numbers: full wells, gains, coefficients of polynomials.
constexpr double kNoUnit = 1e15;
/// Metres: coordinates of a projection, and the earth's size, lie below.
constexpr double kMetres = 1e8;
/// Seconds: 126 years, which int64 nanoseconds hold twice; instants since 1970 lie below.
constexpr double kSeconds = 4e9;

constexpr UnitLimit kLimits[] = {{"m", kMetres},
                                 {"km", kMetres * 1e-3},
                                 {"mm", kMetres * 1e3},
                                 {"um", kMetres * 1e6},
                                 {"nm", kMetres * 1e9},
                                 {"s", kSeconds},
                                 {"h", kSeconds / 3600},
                                 {"ms", kSeconds * 1e3},
                                 {"us", kSeconds * 1e6},
                                 {"ns", kSeconds * 1e9},
                                 {"deg", 1e6},
                                 {"rad", 1e6},
                                 {"mrad", 1e9},
                                 {"mps", 1e6},
                                 {"mps2", 1e6},
                                 {"degps", 1e7},
                                 {"degps2", 1e9},
                                 {"radps", 1e6},
                                 {"radps2", 1e8},
                                 {"px", 1e6},
                                 {"percent", 1e6},
                                 {"c", 1e5},
                                 {"k", 1e5},
                                 {"kg", 1e9}};

bool is_index(std::string_view word) {
  return !word.empty() && std::all_of(word.begin(), word.end(), [](char c) { return c >= '0' && c <= '9'; });
}

std::string_view key_of(std::string_view path) {
  while (true) {
    const auto dot = path.rfind('.');
    if (dot == std::string_view::npos) return path;
    const auto last = path.substr(dot + 1);
    if (!is_index(last)) return last;
    path = path.substr(0, dot);
  }
}

}  // namespace

double unit_limit(std::string_view path) {
  const std::string_view key = key_of(path);
  const auto score = key.rfind('_');
  if (score == std::string_view::npos) return kNoUnit;
  const std::string_view unit = key.substr(score + 1);
  for (const UnitLimit& l : kLimits)
    if (l.unit == unit) {
      // `_per_m`: a reciprocal is large where the length is small.
      return key.substr(0, score).ends_with("_per") ? kNoUnit : l.most;
    }
  return kNoUnit;
}

Range within_unit(std::string_view path, Range range) {
  const double most = unit_limit(path);
  if (!std::isfinite(range.min)) range.min = -most;
  if (!std::isfinite(range.max)) range.max = std::max(most, range.min);
  return range;
}

}  // namespace rigor::config
