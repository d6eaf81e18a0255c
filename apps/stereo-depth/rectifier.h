// Two calibrated cameras as an ideal stereo pair: rows of both pictures look at the same plane through the
// baseline.
//
//   z = focal_px * baseline_m / disparity_px, disparity = u_left - u_right (not negative)
//
// The rotations come from OpenCV's stereoRectify (Bouguet's: each camera turns by half of the angle between
// them). Of its projection matrices nothing is taken: both rectified cameras have the focal length and the
// principal point of `RectifiedCamera`, so that disparities of differently distorted pairs can be compared.
#pragma once

#include <Eigen/Core>
#include <memory>
#include <opencv2/core.hpp>

#include "rt-core/result.h"
#include "sensor-hal/models/camera_model.h"
#include "sensor-hal/types/sample.h"

namespace rigor::stereo {

/// A pinhole, its left one turned by `R_rectified_left` from the left camera and at the same place.
struct RectifiedCamera {
  int width_px = 0, height_px = 0;
  double focal_px = 0, cx_px = 0, cy_px = 0;
  double baseline_m = 0;
  Eigen::Matrix3d R_rectified_left = Eigen::Matrix3d::Identity();
};

struct RectifiedPair {
  cv::Mat left, right;  ///< 8 bits
};

class Rectifier {
 public:
  /// `T_left_right`: the right camera's pose in the left one's optical frame. The rectified pictures have the
  /// size and fx of the left camera, the principal point is their middle. Setup. bad_input: a projection
  /// other than opencv, no baseline, a right camera that stands more in front than beside.
  [[nodiscard]] static Result<Rectifier> make(const CameraModel& left, const CameraModel& right,
                                              const Pose& T_left_right);

  [[nodiscard]] const RectifiedCamera& camera() const { return camera_; }
  /// Bilinear; black where the cameras see nothing. 8-bit pictures of the cameras' sizes. Allocates.
  [[nodiscard]] RectifiedPair rectify(const cv::Mat& left, const cv::Mat& right) const;
  /// 255 where the left (right) camera sees the rectified pixel.
  [[nodiscard]] const cv::Mat& left_mask() const { return left_mask_; }
  [[nodiscard]] const cv::Mat& right_mask() const { return right_mask_; }

 private:
  RectifiedCamera camera_;
  cv::Mat left_u_, left_v_, right_u_, right_v_;
  cv::Mat left_mask_, right_mask_;
};

}  // namespace rigor::stereo
