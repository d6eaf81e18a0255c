// How wrong a simulated channel may be, which `rigor tune` buys speed for.
//
//   tolerance: { range_m: 0.02, outliers: 0.01 }     point_cloud, range_image
//   tolerance: { radiance: 0.02 }                    image
#pragma once

#include <optional>

#include "sensor-hal/config/yaml.h"
#include "sensor-hal/types/sample.h"

namespace rigor {

struct Tolerance {
  double range_m = 0;   ///< root mean square of what is no outlier
  double outliers = 0;  ///< share of rays that are off by more than max(0.1 m, 5 tolerances), or that have
                        ///< no return where the reference has one, or the other way round
  bool outliers_given = false;  ///< written, not the default
  double radiance = 0;          ///< cameras: root mean square of the difference over the mean radiance
};

/// Empty where there is none. Throws ConfigError.
[[nodiscard]] inline std::optional<Tolerance> read_tolerance(const ConfigNode& params, SampleKind kind) {
  const ConfigNode n = params.map_or_absent("tolerance");
  if (!n.present()) return std::nullopt;
  Tolerance t;
  if (kind == SampleKind::image) {
    t.radiance = n.number("radiance", {.min = 0, .max = 10, .exclusive_min = true});
  } else {
    t.range_m = n.number("range_m", {.min = 0, .max = 1000, .exclusive_min = true});
    t.outliers_given = n.has("outliers");
    t.outliers = n.number_or("outliers", 0.01, {.min = 0, .max = 1});
  }
  n.finish();
  return t;
}

}  // namespace rigor
