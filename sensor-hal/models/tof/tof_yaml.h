// Time-of-flight models as files: configs/sensors/*.yaml. What is not written there has the default of the
// struct.
//
//   width_px: 176
//   height_px: 144
//   intrinsics: { fx_px: 220 }                     # fy = fx, principal point in the middle
//   lens: { k1: -0.2 }
//   modulation: { frequencies_mhz: [30], contrast: 0.5, waveform: harmonics, harmonics: [0.03],
//                 integration_time_ms: 8.5, tap_window_ms: 52 }
//   illumination: { wavelength_nm: 850, radiant_intensity_w_per_sr: 0.5 }
//   optics: { f_number: 1.4, filter_width_nm: 40 }
//   pixel: { pitch_um: 40, full_well_e: 400000, read_noise_e: 60, adc_bits: 12 }
//   range_error: { offset_mm: 12, amplitude_error_mm_e: 40000,      # k of k/A
//                  wiggling_spline: { from_m: 0.6, to_m: 2.8, coefficients_mm: [0, 2.1, -0.4, 1.8, 0.2] } }
//   sampling: { samples: 4 }
//   limits: { min_amplitude_e: 100 }
//   filters: { median_px: 3 }
#pragma once

#include <cstdint>
#include <filesystem>

#include "rt-core/result.h"
#include "sensor-hal/config/yaml.h"
#include "sensor-hal/models/tof/tof_model.h"

namespace rigor {

/// `draw`: that device of those which the sensor model's covariance describes (calibration_section.h); 0: the
/// sensor model. not_found, or bad_input with file:line:column. Setup context.
[[nodiscard]] Result<models::TofModel> load_tof_model(const std::filesystem::path& file,
                                                      std::uint64_t draw = 0);
[[nodiscard]] Result<models::TofModel> parse_tof_model(ConfigNode root);

}  // namespace rigor
