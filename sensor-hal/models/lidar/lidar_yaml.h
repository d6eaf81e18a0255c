// LiDAR models as files: configs/sensors/*.yaml. What is not written there has the default of the struct
// (lidar_model.h): an effect that is off.
//
//   wavelength_nm: 905
//   scan: { rotation_hz: 10, direction: clockwise, start_deg: 0, end_deg: -360, column_us: 55.296 }
//   beams: { elevation_deg: [-15, 1, -13, 3], fire_us: [0, 2.304, 4.608, 6.912] }
//   footprint: { divergence_mrad: [3, 1.5], start_diameter_mm: 9.5, sub_rays: 5 }
//   echoes: { separation_m: 0.5, returns: dual }
//   range: { min_m: 0.5, max_m: 100, step_mm: 2 }
//   noise: { scale_mm: 6.5, offset: 0.19, exponent: 1 }
//   remission: { scale: 100, retro_scale: 50, maximum: 255, step: 1 }
//
// A scan goes from start_deg by steps of step_deg (rotation_hz then says when), or by columns every column_us
// (rotation_hz then says where), up to end_deg: included where it does not fall on the start. One number in a
// list of `beams` stands for all beams. A pattern says itself where each firing points, and has no `beams`:
//
//   scan: { kind: pattern, scan_ms: 100, pattern: { file: star.csv, periodic: true } }   # scan_pattern.h
//   scan: { kind: pattern, scan_ms: 100, pattern: { formula: livox_mid360 } }
#pragma once

#include <cstdint>
#include <filesystem>

#include "rt-core/result.h"
#include "sensor-hal/config/yaml.h"
#include "sensor-hal/models/lidar/lidar_model.h"

namespace rigor {

/// `draw`: that device of those which the sensor model's covariance describes (calibration_section.h); 0: the
/// sensor model. not_found, or bad_input with file:line:column. Setup context.
[[nodiscard]] Result<models::LidarModel> load_lidar_model(const std::filesystem::path& file,
                                                          std::uint64_t draw = 0);
[[nodiscard]] Result<models::LidarModel> parse_lidar_model(ConfigNode root);

}  // namespace rigor
