// Camera models as files: configs/sensors/*.yaml. What is not written there has the default of the struct.
//
//   width_px: 640
//   height_px: 480
//   intrinsics: { fx_px: 620, fy_px: 620, cx_px: 319.5, cy_px: 239.5 }
//   lens: { k1: -0.21, k2: 0.06 }
//   vignetting: { cos4_weight: 1 }
//   optics: { f_number: 2.8 }
//   noise: { read_noise_e: 5, adc_bits: 12 }
#pragma once

#include <cstdint>
#include <filesystem>

#include "rt-core/result.h"
#include "sensor-hal/config/yaml.h"
#include "sensor-hal/models/camera_model.h"

namespace rigor {

struct CameraSensorModel {
  CameraModel model;
  double exposure_s = 0.005;   ///< default of the device
  double supersampling = 1.0;  ///< view pixels per sensor pixel along one side, for the renderer raster
};

/// `draw`: that device of those which the sensor model's covariance describes (calibration_section.h); 0: the
/// sensor model. not_found, or bad_input with file:line:column. Setup context.
[[nodiscard]] Result<CameraSensorModel> load_camera(const std::filesystem::path& file,
                                                    std::uint64_t draw = 0);
[[nodiscard]] Result<CameraSensorModel> parse_camera(ConfigNode root);

}  // namespace rigor
