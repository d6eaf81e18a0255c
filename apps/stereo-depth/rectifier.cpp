#include "apps/stereo-depth/rectifier.h"

#include <Eigen/Geometry>
#include <cmath>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>

namespace rigor::stereo {
namespace {

cv::Matx33d matrix_of(const CameraModel& c) { return {c.fx_px, 0, c.cx_px, 0, c.fy_px, c.cy_px, 0, 0, 1}; }

cv::Mat lens_of(const CameraModel& c) {
  const OpenCvLens& l = c.lens;
  return (cv::Mat_<double>(1, 8) << l.k1, l.k2, l.p1, l.p2, l.k3, l.k4, l.k5, l.k6);
}

cv::Mat mask_of(const cv::Mat& u, const cv::Mat& v, const CameraModel& c) {
  cv::Mat mask(u.size(), CV_8U);
  for (int y = 0; y < u.rows; ++y)
    for (int x = 0; x < u.cols; ++x) {
      const float a = u.at<float>(y, x), b = v.at<float>(y, x);
      // A map without distortion puts the edge there up to rounding.
      constexpr float kRounding_px = 1e-3F;
      const bool inside = a >= -kRounding_px && b >= -kRounding_px &&
                          a <= static_cast<float>(c.width_px - 1) + kRounding_px &&
                          b <= static_cast<float>(c.height_px - 1) + kRounding_px;
      mask.at<std::uint8_t>(y, x) = inside ? 255 : 0;
    }
  return mask;
}

}  // namespace

Result<Rectifier> Rectifier::make(const CameraModel& left, const CameraModel& right,
                                  const Pose& T_left_right) {
  if (left.projection != Projection::opencv || right.projection != Projection::opencv)
    return fail(
        ErrorCode::bad_input, "stereo",
        "expected cameras with the projection opencv, got a fisheye: the rectified picture is a pinhole's");
  const auto& q = T_left_right.orientation_wxyz;
  const Eigen::Quaterniond turn(q[0], q[1], q[2], q[3]);
  const Eigen::Vector3d at(T_left_right.position_m[0], T_left_right.position_m[1],
                           T_left_right.position_m[2]);
  if (!(at.norm() > 1e-4) || std::abs(turn.norm() - 1) > 1e-6)
    return fail(
        ErrorCode::bad_input, "stereo",
        "T_left_right: expected the right camera's pose in the left one's frame, at least 0.1 mm beside it");
  if (!(at.x() > std::hypot(at.y(), at.z())))
    return fail(
        ErrorCode::bad_input, "stereo",
        "T_left_right: expected the right camera to the right of the left one (x of its optical frame), it "
        "stands farther up, down, behind or in front");
  // OpenCV's R, T map points of the left camera into the right one.
  const Eigen::Matrix3d R = turn.normalized().toRotationMatrix().transpose();
  const Eigen::Vector3d t = -R * at;
  cv::Matx33d R_cv;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) R_cv(i, j) = R(i, j);
  cv::Mat R1, R2, P1, P2, Q;
  cv::stereoRectify(matrix_of(left), lens_of(left), matrix_of(right), lens_of(right),
                    cv::Size(left.width_px, left.height_px), R_cv, cv::Vec3d(t.x(), t.y(), t.z()), R1, R2, P1,
                    P2, Q, cv::CALIB_ZERO_DISPARITY, -1);
  Rectifier r;
  RectifiedCamera& c = r.camera_;
  c.width_px = left.width_px, c.height_px = left.height_px;
  c.focal_px = left.fx_px;
  c.cx_px = (c.width_px - 1) / 2.0, c.cy_px = (c.height_px - 1) / 2.0;
  c.baseline_m = at.norm();
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) c.R_rectified_left(i, j) = R1.at<double>(i, j);
  const cv::Matx33d K(c.focal_px, 0, c.cx_px, 0, c.focal_px, c.cy_px, 0, 0, 1);
  const cv::Size size(c.width_px, c.height_px);
  cv::initUndistortRectifyMap(matrix_of(left), lens_of(left), R1, K, size, CV_32FC1, r.left_u_, r.left_v_);
  cv::initUndistortRectifyMap(matrix_of(right), lens_of(right), R2, K, size, CV_32FC1, r.right_u_,
                              r.right_v_);
  r.left_mask_ = mask_of(r.left_u_, r.left_v_, left);
  r.right_mask_ = mask_of(r.right_u_, r.right_v_, right);
  return r;
}

RectifiedPair Rectifier::rectify(const cv::Mat& left, const cv::Mat& right) const {
  RectifiedPair out;
  cv::remap(left, out.left, left_u_, left_v_, cv::INTER_LINEAR, cv::BORDER_CONSTANT);
  cv::remap(right, out.right, right_u_, right_v_, cv::INTER_LINEAR, cv::BORDER_CONSTANT);
  return out;
}

}  // namespace rigor::stereo
