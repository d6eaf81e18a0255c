// Derivatives of where a point of a board falls: the pose by the chain rule, the lens through jets of fixed
// size over the simulator's own formulas. Internal to calibration/camera.
#pragma once

#include <ceres/jet.h>
#include <ceres/rotation.h>

#include <Eigen/Core>

#include "calibration/camera/reprojection.h"

namespace rigor::calibration {

template <int R, int C>
using Rows = Eigen::Matrix<double, R, C, Eigen::RowMajor>;

/// Columns of the rotation of an angle-axis vector, and the derivative of each by the vector.
struct Rotation {
  Eigen::Matrix3d r;
  Eigen::Matrix3d by[3];  ///< by[k] = d(r·e_k)/dw

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

inline bool distort_fisheye(const double* camera, const Eigen::Vector3d& p, Distorted& d) {
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

inline bool distort_opencv(const double* camera, const Eigen::Vector3d& p, Distorted& d) {
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

/// False: the point has no image.
inline bool distort(const double* camera, bool fisheye, const Eigen::Vector3d& p, Distorted& d) {
  return fisheye ? distort_fisheye(camera, p, d) : distort_opencv(camera, p, d);
}

}  // namespace rigor::calibration
