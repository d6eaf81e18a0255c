// Intrinsics and lens of a camera from views of a board.
//
// Model: sensor-hal/models/opencv_lens.glsl.h and fisheye_lens.glsl.h, the files that the simulator reads,
// over ceres::Jet. Parameters fx_px, fy_px, cx_px, cy_px and the coefficients of the lens model; a pose for
// each view is solved for and marginalised. Nested models are compared by BIC and by cross-validation over
// views: the model is fitted without a share of the views, their poses alone are then fitted, and what is
// left is the error.
#pragma once

#include <Eigen/Geometry>
#include <functional>
#include <limits>
#include <string>
#include <vector>

#include "calibration/camera/board.h"
#include "calibration/core/fit_result.h"
#include "rt-core/result.h"
#include "rt-core/stop.h"
#include "sensor-hal/models/camera_model.h"

namespace rigor::calibration {

/// How many coefficients the lens has: none; k1 k2; and p1 p2; and k3; and k4 k5 k6; Kannala–Brandt k1 … k4.
enum class LensModel : std::uint8_t { opencv0, opencv2, opencv4, opencv5, opencv8, fisheye4 };
[[nodiscard]] std::string_view lens_model_name(LensModel m);
/// bad_input with the names that there are.
[[nodiscard]] Result<LensModel> parse_lens_model(const std::string& name);

struct CameraFitOptions {
  /// Compared; empty: opencv0 … opencv5 (opencv8 needs more views than most people take, and a fisheye is
  /// asked for).
  std::vector<LensModel> models;
  bool robust = true;
  double reject_sigmas = 4;
  int folds = 5;  ///< of the cross-validation; 0: none
  int threads = 0;
  double start_fx_px = 0;  ///< 0: found from the views
  StopToken stop{};
  std::function<void(double, double)> progress{};
};

/// Uncertainty of projection: standard deviation of where a ray falls, worst direction, after the rotation
/// that the board poses would take up has been taken out. Row by row on a grid over the picture.
struct UncertaintyMap {
  int columns = 0, rows = 0;
  double step_px = 0;
  std::vector<double> sigma_px;  ///< NaN where the lens has no ray
};

struct CameraFit {
  FitResult result;
  LensModel lens_model = LensModel::opencv4;
  CameraModel camera;  ///< geometry and lens; the rest is the default
  std::vector<Eigen::Isometry3d> T_camera_board;
  std::vector<double> view_rms_px;  ///< per corner, of those used; NaN: none
  double rms_per_corner_px = 0;     ///< √(Σ|r|²/corners)
  UncertaintyMap uncertainty;
  /// 95 % quantile over the picture of how far fits to the odd and to the even views put the same ray apart;
  /// NaN: fewer than four views.
  double halves_apart_px = std::numeric_limits<double>::quiet_NaN();
  struct Residual {
    std::size_t view;
    double u_px, v_px, du_px, dv_px;
    bool used;
  };
  std::vector<Residual> residuals;  ///< of every corner
};

/// A view that is a copy of an earlier one is left out and named. Asked to stop, gives the best so far,
/// marked. Parameters whose sigma is contradicted by fits to halves of the views are in
/// result.not_identifiable. bad_input: fewer than two views, mixed picture sizes, nothing to fit. What the
/// views do not determine is in result.weak with what to record.
[[nodiscard]] Result<CameraFit> fit_camera(const std::vector<BoardView>& views,
                                           const CameraFitOptions& options);

}  // namespace rigor::calibration
