// Line time of a rolling shutter, from views of a board that moves before the camera (or it before the
// board).
//
// Row v of a picture is exposed (v − (height − 1)/2)·line_time_s after its centre row, which is the picture's
// time (sensor-hal/models/camera_model.h, row_delay_s). Where the board was then is interpolated: through the
// poses of up to five views around it runs a polynomial in time (Lagrange), of the six numbers of angle-axis
// and translation. So line time, intrinsics and poses are fitted together, and the speed is nobody's guess;
// it must be smooth over five pictures. Poses alone without times say nothing: twice the speed and half the
// line time give the same picture.
#pragma once

#include "calibration/camera/camera_fit.h"

namespace rigor::calibration {

struct RollingShutterOptions {
  /// Views further apart in time do not say how the board moved between them.
  double longest_gap_s = 0.2;
};

/// As fit_camera(), with the parameter `line_time_s` after the others and `camera.shutter.line_time_s` set.
/// Views need their `t_s`. A view with fewer than two others near it in time, which leaves open how it moved,
/// is left out and named. Where nothing moved, or no times are known, the fit is that of fit_camera() and
/// `line_time_s` is in `not_identifiable` with the reason. Models are compared on corners from which the
/// motion has been taken out.
[[nodiscard]] Result<CameraFit> fit_rolling_shutter(const std::vector<BoardView>& views,
                                                    const CameraFitOptions& options,
                                                    const RollingShutterOptions& shutter = {});

}  // namespace rigor::calibration
