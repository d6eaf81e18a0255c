// Lateral chromatic aberration: how much larger the picture in red and in blue is than in green.
//
// The simulator multiplies the distorted coordinates of each colour by its own factor about the principal
// point (CameraModel::chromatic.magnification). A factor of all three is a focal length, so green is held at
// 1 and intrinsics are those of green.
#pragma once

#include <array>

#include "calibration/camera/camera_fit.h"

namespace rigor::calibration {

/// Views of the same pictures in red, green and blue: the same corners in the same order.
using ColourViews = std::array<BoardView, 3>;

/// As fit_camera() on green, then all three together with the parameters `magnification_red` and
/// `magnification_blue` after the others. The residuals are those of all colours, `view` the picture. The
/// corners of three colours are taken as independent; where a mosaic was made to colours they are not quite,
/// and the sigmas are then too small by up to √3.
[[nodiscard]] Result<CameraFit> fit_chromatic(const std::vector<ColourViews>& views,
                                              const CameraFitOptions& options);

}  // namespace rigor::calibration
