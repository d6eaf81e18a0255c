// Vignetting of a camera in the simulator's model (sensor-hal/models/vignetting.glsl.h, the file itself over
// ceres::Jet):
//
//   V = (1 − G + G cos⁴θ)(1 + a2 r² + a4 r⁴ + a6 r⁶),  r = tan θ of the ideal ray of the cell
//
// so that the camera's intrinsics and lens have to be known. Nested models are compared by BIC and by
// cross-validation over sectors of the picture. G and a2 do nearly the same: no model frees both.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "calibration/core/fit_result.h"
#include "calibration/shading/flat_field.h"
#include "rt-core/result.h"
#include "rt-core/stop.h"
#include "sensor-hal/models/camera_model.h"

namespace rigor::calibration {

/// cos4: G alone; r2, r4, r6: the polynomial up to that power, G = 0.
enum class ShadingModel : std::uint8_t { none, cos4, r2, r4, r6 };
[[nodiscard]] std::string_view shading_model_name(ShadingModel m);
/// bad_input with the names that there are.
[[nodiscard]] Result<ShadingModel> parse_shading_model(const std::string& name);

struct ShadingFitOptions {
  std::vector<ShadingModel> models;  ///< compared; empty: all (a fisheye: none and cos4)
  double reject_sigmas = 4;
  StopToken stop{};
};

struct ShadingFit {
  FitResult result;  ///< `scale` (light on the axis), `cos4_weight`, `a2`, `a4`, `a6`
  ShadingModel model = ShadingModel::none;
  Vignetting vignetting;
  double rms = 0;                ///< of measured less fitted light, in units of the light on the axis
  double rms_relative = 0;       ///< of measured over fitted light, minus 1: the dark corners weigh more
  std::vector<double> fitted;    ///< light of each cell by the fit
  std::vector<double> residual;  ///< in units of the light on the axis
  /// Where the light is centred, apart from the principal point; the simulator's model has it there.
  double centre_du_px = 0, centre_dv_px = 0, centre_sigma_px = 0;
  double centred_rms = 0;  ///< if it could be there
};

/// bad_input: fewer cells than the models have parameters, all near the axis. Cells without a ray (beyond the
/// lens model's fold) are left out and counted in a warning.
[[nodiscard]] Result<ShadingFit> fit_shading(const std::vector<ShadingCell>& cells, const CameraModel& camera,
                                             const ShadingFitOptions& options);

}  // namespace rigor::calibration
