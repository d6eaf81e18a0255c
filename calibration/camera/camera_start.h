// Where a camera fit begins. Internal to calibration/camera.
#pragma once

#include <array>
#include <vector>

#include "calibration/camera/board.h"
#include "sensor-hal/models/camera_model.h"

namespace rigor::calibration {

/// Focal length from the views' homographies with square pixels and the principal point in the middle
/// (Zhang, PAMI 2000, with one unknown); 0 where they do not tell.
[[nodiscard]] double focal_length_from_views(const std::vector<BoardView>& views);

/// Angle-axis and translation of T_camera_board from the points of one view, for a pinhole (or, `fisheye`, an
/// equidistant lens) of this focal length. False: the points have no such view.
[[nodiscard]] bool pose_from_view(const BoardView& view, double fx_px, double fy_px, double cx_px,
                                  double cy_px, bool fisheye, std::array<double, 6>& pose);

/// The poses, as above, that the points of a view have in a camera whose lens is known: none to two.
/// `robust`: up to half of the points may be wrong.
[[nodiscard]] std::vector<std::array<double, 6>> poses_from_view(const BoardView& view,
                                                                 const CameraModel& camera,
                                                                 bool robust = false);

}  // namespace rigor::calibration
