#include "calibration/camera/view_cost.h"

#include <ceres/jet.h>
#include <ceres/rotation.h>

#include <Eigen/Core>
#include <limits>

#include "calibration/camera/reprojection.h"

namespace rigor::calibration {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;
template <int R, int C>
using Rows = Eigen::Matrix<double, R, C, Eigen::RowMajor>;

/// Columns of the rotation of an angle-axis vector, and the derivative of each by the vector.
struct Rotation {
  Matrix3d r;
  Matrix3d by[3];  ///< by[k] = d(r·e_k)/dw

  explicit Rotation(const double* w) {
    using Jet = ceres::Jet<double, 3>;
    const Jet jets[3] = {Jet(w[0], 0), Jet(w[1], 1), Jet(w[2], 2)};
    for (int k = 0; k < 3; ++k) {
      const Jet e[3] = {Jet(k == 0), Jet(k == 1), Jet(k == 2)};
      Jet out[3];
      ceres::AngleAxisRotatePoint(jets, e, out);
      for (int i = 0; i < 3; ++i) {
        r(i, k) = out[i].a;
        by[k].row(i) = out[i].v.transpose();
      }
    }
  }
};

/// Distorted coordinates of a point, by the point and by the coefficients of the lens (8; a fisheye has 4).
struct Distorted {
  Eigen::Vector2d xy;
  Rows<2, 3> by_point;
  Rows<2, 8> by_lens;
};

bool distort_fisheye(const double* camera, const Vector3d& p, Distorted& d) {
  using Jet = ceres::Jet<double, 7>;
  Jet x, y, valid;
  models::LensMath<Jet>::fisheye_project(Jet(p.x(), 0), Jet(p.y(), 1), Jet(p.z(), 2), Jet(camera[4], 3),
                                         Jet(camera[5], 4), Jet(camera[6], 5), Jet(camera[7], 6),
                                         Jet(kThetaMax), x, y, valid);
  if (valid.a < 0.5) return false;
  d.xy = {x.a, y.a};
  d.by_point << x.v.head<3>().transpose(), y.v.head<3>().transpose();
  d.by_lens.setZero();
  d.by_lens.leftCols<4>() << x.v.tail<4>().transpose(), y.v.tail<4>().transpose();
  return true;
}

bool distort_opencv(const double* camera, const Vector3d& p, Distorted& d) {
  if (!(p.z() > 0)) return false;
  using Jet = ceres::Jet<double, 10>;
  const double inverse = 1 / p.z(), xn = p.x() * inverse, yn = p.y() * inverse;
  Jet k[8];
  for (int i = 0; i < 8; ++i) k[i] = Jet(camera[4 + i], 2 + i);
  Jet x, y;
  models::LensMath<Jet>::lens_distort(Jet(xn, 0), Jet(yn, 1), k[0], k[1], k[2], k[3], k[4], k[5], k[6], k[7],
                                      x, y);
  d.xy = {x.a, y.a};
  const auto by_point = [&](const Jet& j, int row) {
    d.by_point(row, 0) = j.v[0] * inverse;
    d.by_point(row, 1) = j.v[1] * inverse;
    d.by_point(row, 2) = -(j.v[0] * xn + j.v[1] * yn) * inverse;
  };
  by_point(x, 0), by_point(y, 1);
  d.by_lens << x.v.tail<8>().transpose(), y.v.tail<8>().transpose();
  return true;
}

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
      const bool seen = options_.fisheye ? distort_fisheye(camera, p, d) : distort_opencv(camera, p, d);
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
