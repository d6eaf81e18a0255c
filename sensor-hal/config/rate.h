// Rates in YAML: `rate_hz: 30`, `29.97` (the exact decimal fraction) or `60000/1001`.
#pragma once

#include <string_view>

#include "rt-core/period.h"
#include "sensor-hal/config/yaml.h"

namespace rigor {

/// Throws ConfigError where the key is missing, is no rate, or is out of `range`, which is in hertz.
[[nodiscard]] Period read_rate(const ConfigNode& n, std::string_view key, Range range);
/// The same with a default for a missing key.
[[nodiscard]] Period read_rate_or(const ConfigNode& n, std::string_view key, Period fallback, Range range);

}  // namespace rigor
