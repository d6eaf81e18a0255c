// Inertial measurement units as files: configs/sensors/*.yaml, in the units of data sheets. What is not
// written there is an error that the device does not have.
//
//   name: …
//   accelerometer:
//     bias_mg: [0, 0, 0]  bias_sigma_mg: 20            # of this device; of devices of this kind
//     bias_per_k_mg: [0, 0, 0]  bias_per_k_sigma_mg: 0.2
//     scale_percent: [0, 0, 0]  scale_sigma_percent: 0.5
//     misalignment_percent: [xy, xz, yx, yz, zx, zy]  misalignment_sigma_percent: 0.5
//     noise_density_ug_per_sqrt_hz: [160, 160, 190]    # over positive frequencies; or
//     velocity_random_walk_m_per_s_per_sqrt_h: 0.07    # N
//     instability_mg: 0.04                             # B: floor of the Allan deviation over 0.664
//     instability_time_s: 100
//     random_walk_mg_per_sqrt_h: 0.1                   # K
//     bandwidth_hz: 145  range_g: 24  resolution_mg: 0.732
//   gyroscope:
//     as above with bias_deg_per_s, bias_per_k_deg_per_s, noise_density_deg_per_s_per_sqrt_hz or
//     angle_random_walk_deg_per_sqrt_h, instability_deg_per_h, random_walk_deg_per_h_per_sqrt_h,
//     range_deg_per_s, resolution_deg_per_s and
//     g_sensitivity_deg_per_s_per_g: [9 numbers, row by row]  g_sensitivity_sigma_deg_per_s_per_g: 0.1
//   temperature: { told: true, ambient_c: 20, warm_up_k: 8, warm_up_time_s: 300, resolution_k: 0.125 }
//   delay_ms: 1.5
//   earth_rate: false
//
// 1 g is 9.80665 m/s².
#pragma once

#include <filesystem>

#include "rt-core/result.h"
#include "sensor-hal/config/yaml.h"
#include "sensor-hal/models/imu/imu_model.h"

namespace rigor {

/// not_found, or bad_input with file:line:column. Setup context.
[[nodiscard]] Result<models::ImuModel> load_imu_model(const std::filesystem::path& file);
[[nodiscard]] Result<models::ImuModel> parse_imu_model(ConfigNode root);

}  // namespace rigor
