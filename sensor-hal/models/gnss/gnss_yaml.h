// Satellite receivers as files: configs/sensors/*.yaml. What is not written there is an error that the
// receiver does not have.
//
//   name: …
//   status: fix                # fix, sbas, rtk_fixed: at its best
//   noise: { white_horizontal_m: 0.3, white_vertical_m: 0.6,
//            drift_horizontal_m: 1.0, drift_vertical_m: 2.0, drift_time_s: 600 }
//   rtk_float: { as noise }    # of a receiver with status rtk_fixed
//   losses: { per_h: 4, mean_s: 20 }       # of the fixed solution
//   outages: { per_h: 0.5, mean_s: 5 }     # of any
//   multipath: { horizontal_m: 0.5, vertical_m: 0.8, time_s: 20 }
//   canopy: { multipath: 4, events: 10, satellites: 5 }    # under a closed one: times, times, fewer
//   satellites: { mean: 14, sigma: 1.5, time_s: 60 }
//   first_fix_s: 0
//   claimed_scale: 1           # claimed over true standard deviation
//   antenna_m: [0, 0, 0]       # phase centre in the sensor's frame
//   delay_ms: 0
#pragma once

#include <filesystem>

#include "rt-core/result.h"
#include "sensor-hal/config/yaml.h"
#include "sensor-hal/models/gnss/gnss_model.h"

namespace rigor {

/// not_found, or bad_input with file:line:column. Setup context.
[[nodiscard]] Result<models::GnssModel> load_gnss_model(const std::filesystem::path& file);
[[nodiscard]] Result<models::GnssModel> parse_gnss_model(ConfigNode root);

}  // namespace rigor
