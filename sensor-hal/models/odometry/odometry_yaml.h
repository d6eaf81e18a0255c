// Odometry of vehicles as files: configs/sensors/*.yaml.
//
//   name: …
//   wheel_radius_m: 0.2
//   track_m: 1.12                     # between the sides; with skid steering the effective one
//   ticks_per_turn: 8192              # of a wheel; left away: no rounding
//   radius_error_percent: [0, 0]      radius_error_sigma_percent: 0.5
//   track_error_percent: 0            track_error_sigma_percent: 2
//   claimed: { position_percent_of_way: 3, yaw_deg_per_m: 0.5, yaw_percent_of_turn: 5,
//              speed_mps: 0.02, turn_deg_per_s: 2 }
#pragma once

#include <filesystem>

#include "rt-core/result.h"
#include "sensor-hal/config/yaml.h"
#include "sensor-hal/models/odometry/odometry_model.h"

namespace rigor {

/// not_found, or bad_input with file:line:column. Setup context.
[[nodiscard]] Result<models::OdometryModel> load_odometry_model(const std::filesystem::path& file);
[[nodiscard]] Result<models::OdometryModel> parse_odometry_model(ConfigNode root);

}  // namespace rigor
