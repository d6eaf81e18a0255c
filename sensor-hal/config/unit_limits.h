// The range of every number of a file: what its reader says, and beyond that what the unit in its key allows.
//
//   position_m: [1e300, 0, 0]   expected a number from -1e+08 to 1e+08, got 1e300
//
// A reader that gives no bound still refuses what no rig, sensor or world has and what arithmetic on int64
// nanoseconds or floats would not survive. docs/configuration.md lists the limits.
#pragma once

#include <string_view>

#include "sensor-hal/config/yaml.h"

namespace rigor::config {

/// The greatest magnitude of a number with this key, by the unit that ends its name: `_m` 1e8, `_ms` 4e12 …;
/// 1e15 without a unit. Prefixes of SI are understood. `path` may be a path, and may end in indices of lists.
[[nodiscard]] double unit_limit(std::string_view path);
/// `range`, with the bounds that it lacks filled in.
[[nodiscard]] Range within_unit(std::string_view path, Range range);

}  // namespace rigor::config
