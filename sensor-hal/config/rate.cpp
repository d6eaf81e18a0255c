#include "sensor-hal/config/rate.h"

#include <cstdio>
#include <string>

namespace rigor {

Period read_rate(const ConfigNode& n, std::string_view key, Range range) {
  const std::string text = n.scalar_or_empty(key);
  const bool fraction = text.find('/') != std::string::npos;
  // What is no number at all is refused in the words of numbers.
  if (!fraction) (void)n.number(key, range);
  const auto period = parse_rate(text);
  if (!period) throw n.error(key, period.error().message);
  if (fraction && !(period->hz() >= range.min && period->hz() <= range.max)) {
    char expected[80];
    std::snprintf(expected, sizeof expected, "expected a rate from %g to %g, got ", range.min, range.max);
    throw n.error(key, expected + text);
  }
  return *period;
}

Period read_rate_or(const ConfigNode& n, std::string_view key, Period fallback, Range range) {
  return n.has(key) ? read_rate(n, key, range) : fallback;
}

}  // namespace rigor
