#include "calibration/camera/view_cost.h"

#include <Eigen/Core>
#include <limits>

#include "calibration/camera/point_jacobian.h"

namespace rigor::calibration {
namespace {

using Eigen::Vector3d;

class ViewCost final : public ceres::CostFunction {
 public:
  ViewCost(std::vector<BoardPoint> points, const ViewCostOptions& options)
      : points_(std::move(points)), options_(options) {
    set_num_residuals(2 * static_cast<int>(points_.size()));
    auto& sizes = *mutable_parameter_block_sizes();
    sizes = {kCameraParameters};
    if (options.magnified) sizes.push_back(1);
    if (options.rig) sizes.push_back(6);
    sizes.push_back(6);
  }

  bool Evaluate(const double* const* x, double* residuals, double** jacobians) const override {
    const double* camera = x[0];
    const std::size_t rig_at = options_.magnified ? 2 : 1, pose_at = rig_at + (options_.rig ? 1 : 0);
    const double factor = options_.magnified ? x[1][0] : 1;
    const double* pose = x[pose_at];
    const Rotation turn(pose);
    const Vector3d shift(pose[3], pose[4], pose[5]);
    const double none[6] = {};
    const double* rig = options_.rig ? x[rig_at] : none;
    const Rotation rig_turn(rig);
    const Vector3d rig_shift(rig[3], rig[4], rig[5]);
    for (std::size_t i = 0; i < points_.size(); ++i) {
      const BoardPoint& b = points_[i];
      const Vector3d other = b.x_m * turn.r.col(0) + b.y_m * turn.r.col(1) + shift;
      const Vector3d p = options_.rig ? Vector3d(rig_turn.r * other + rig_shift) : other;
      double* r = residuals + 2 * i;
      if (!jacobians) {
        double u, v;
        const bool seen = project_point(camera, p.data(), options_.fisheye, kThetaMax, factor, u, v);
        r[0] = seen ? u - b.u_px : kInfinity;
        r[1] = seen ? v - b.v_px : kInfinity;
        continue;
      }
      Distorted d;
      const bool seen = distort(camera, options_.fisheye, p, d);
      if (!seen) {
        r[0] = r[1] = kInfinity;
        for (std::size_t k = 0; k < parameter_block_sizes().size(); ++k)
          if (jacobians[k]) {
            const int n = parameter_block_sizes()[k];
            std::fill_n(jacobians[k] + 2 * static_cast<std::ptrdiff_t>(i) * n, 2 * n, 0.0);
          }
        continue;
      }
      const double fx = factor * camera[0], fy = factor * camera[1];
      r[0] = fx * d.xy[0] + camera[2] - b.u_px;
      r[1] = fy * d.xy[1] + camera[3] - b.v_px;
      if (jacobians[0]) {
        Eigen::Map<Rows<2, kCameraParameters>> j(jacobians[0] + 2 * i * kCameraParameters);
        j.leftCols<4>() << factor * d.xy[0], 0, 1, 0, 0, factor * d.xy[1], 0, 1;
        j.row(0).tail<8>() = fx * d.by_lens.row(0);
        j.row(1).tail<8>() = fy * d.by_lens.row(1);
      }
      if (options_.magnified && jacobians[1]) {
        jacobians[1][2 * i] = camera[0] * d.xy[0];
        jacobians[1][2 * i + 1] = camera[1] * d.xy[1];
      }
      Rows<2, 3> by_point = d.by_point;
      by_point.row(0) *= fx;
      by_point.row(1) *= fy;
      if (options_.rig) {
        if (jacobians[rig_at]) {
          Eigen::Map<Rows<2, 6>> j(jacobians[rig_at] + 2 * i * 6);
          j.leftCols<3>() =
              by_point * (other[0] * rig_turn.by[0] + other[1] * rig_turn.by[1] + other[2] * rig_turn.by[2]);
          j.rightCols<3>() = by_point;
        }
        by_point = (by_point * rig_turn.r).eval();
      }
      if (jacobians[pose_at]) {
        Eigen::Map<Rows<2, 6>> j(jacobians[pose_at] + 2 * i * 6);
        j.leftCols<3>() = by_point * (b.x_m * turn.by[0] + b.y_m * turn.by[1]);
        j.rightCols<3>() = by_point;
      }
    }
    return true;
  }

 private:
  static constexpr double kInfinity = std::numeric_limits<double>::infinity();
  std::vector<BoardPoint> points_;
  ViewCostOptions options_;
};

}  // namespace

ceres::CostFunction* view_cost(std::vector<BoardPoint> points, const ViewCostOptions& options) {
  return new ViewCost(std::move(points), options);
}

}  // namespace rigor::calibration
