#include "calibration/camera/moving_view_cost.h"

#include <limits>

#include "calibration/camera/point_jacobian.h"

namespace rigor::calibration {
namespace {

class MovingViewCost final : public ceres::CostFunction {
 public:
  MovingViewCost(std::vector<BoardPoint> points, bool fisheye, const MotionWindow& window,
                 double middle_row_px)
      : points_(std::move(points)), fisheye_(fisheye), window_(window), middle_row_px_(middle_row_px) {
    set_num_residuals(2 * static_cast<int>(points_.size()));
    auto& sizes = *mutable_parameter_block_sizes();
    sizes = {kCameraParameters, 1};
    sizes.insert(sizes.end(), window.count, 6);
  }

  bool Evaluate(const double* const* x, double* residuals, double** jacobians) const override {
    const double* camera = x[0];
    const std::size_t n = window_.count;
    for (std::size_t i = 0; i < points_.size(); ++i) {
      const BoardPoint& b = points_[i];
      double* r = residuals + 2 * i;
      const double rows = b.v_px - middle_row_px_;
      double weight[MotionWindow::kMost], slope[MotionWindow::kMost];
      window_.weights(kUs * x[1][0] * rows, weight, slope);
      double pose[6] = {}, speed[6] = {};
      for (std::size_t k = 0; k < n; ++k)
        for (std::size_t c = 0; c < 6; ++c)
          pose[c] += weight[k] * x[2 + k][c], speed[c] += slope[k] * x[2 + k][c];
      Distorted d;
      bool seen = false;
      Eigen::Matrix<double, 3, 6> by_pose;
      if (jacobians) {
        const Rotation turn(pose);
        const Eigen::Vector3d p =
            b.x_m * turn.r.col(0) + b.y_m * turn.r.col(1) + Eigen::Vector3d(pose[3], pose[4], pose[5]);
        by_pose << b.x_m * turn.by[0] + b.y_m * turn.by[1], Eigen::Matrix3d::Identity();
        seen = distort(camera, fisheye_, p, d);
        if (seen) {
          r[0] = camera[0] * d.xy[0] + camera[2] - b.u_px;
          r[1] = camera[1] * d.xy[1] + camera[3] - b.v_px;
        }
      } else {
        seen = Reprojection{b.x_m, b.y_m, b.u_px, b.v_px, fisheye_}(camera, pose, r);
      }
      if (!seen) r[0] = r[1] = std::numeric_limits<double>::infinity();
      if (!jacobians) continue;
      if (!seen) {
        for (std::size_t k = 0; k < parameter_block_sizes().size(); ++k)
          if (jacobians[k]) {
            const auto size = static_cast<std::size_t>(parameter_block_sizes()[k]);
            std::fill_n(jacobians[k] + 2 * i * size, 2 * size, 0.0);
          }
        continue;
      }
      if (jacobians[0]) {
        Eigen::Map<Rows<2, kCameraParameters>> j(jacobians[0] + 2 * i * kCameraParameters);
        j.leftCols<4>() << d.xy[0], 0, 1, 0, 0, d.xy[1], 0, 1;
        j.row(0).tail<8>() = camera[0] * d.by_lens.row(0);
        j.row(1).tail<8>() = camera[1] * d.by_lens.row(1);
      }
      Rows<2, 3> by_point = d.by_point;
      by_point.row(0) *= camera[0];
      by_point.row(1) *= camera[1];
      const Rows<2, 6> j_pose = by_point * by_pose;
      if (jacobians[1])
        Eigen::Map<Eigen::Vector2d>(jacobians[1] + 2 * i) =
            j_pose * Eigen::Map<const Eigen::Matrix<double, 6, 1>>(speed) * (kUs * rows);
      for (std::size_t k = 0; k < n; ++k)
        if (jacobians[2 + k]) Eigen::Map<Rows<2, 6>>(jacobians[2 + k] + 12 * i) = weight[k] * j_pose;
    }
    return true;
  }

 private:
  std::vector<BoardPoint> points_;
  bool fisheye_;
  MotionWindow window_;
  double middle_row_px_;
};

}  // namespace

void MotionWindow::weights(double t, double* weight, double* slope) const {
  for (std::size_t k = 0; k < count; ++k) {
    double product = 1, derivative = 0;
    for (std::size_t j = 0; j < count; ++j) {
      if (j == k) continue;
      const double over = 1 / (t_s[k] - t_s[j]);
      derivative = derivative * (t - t_s[j]) * over + product * over;
      product *= (t - t_s[j]) * over;
    }
    weight[k] = product, slope[k] = derivative;
  }
}

std::array<double, 6> MotionWindow::pose_at(double t, const double* const* poses) const {
  double weight[kMost], slope[kMost];
  weights(t, weight, slope);
  std::array<double, 6> pose{};
  for (std::size_t k = 0; k < count; ++k)
    for (std::size_t c = 0; c < 6; ++c) pose[c] += weight[k] * poses[k][c];
  return pose;
}

ceres::CostFunction* moving_view_cost(std::vector<BoardPoint> points, bool fisheye,
                                      const MotionWindow& window, double middle_row_px) {
  return new MovingViewCost(std::move(points), fisheye, window, middle_row_px);
}

}  // namespace rigor::calibration
