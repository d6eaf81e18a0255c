#include "calibration/camera/projection_uncertainty.h"

#include <ceres/jet.h>
#include <Eigen/Dense>

#include <algorithm>
#include <cmath>
#include <limits>

#include "calibration/camera/camera_fit_internal.h"
#include "calibration/camera/reprojection.h"

namespace rigor::calibration {
namespace {

constexpr int kColumns = 24;

struct Grid {
  int columns = 0, rows = 0;
  double step_px = 0;
  std::vector<Eigen::Vector3d> ray;  ///< zero: none
};
Grid grid_of(const CameraModel& camera) {
  Grid g;
  g.columns = kColumns;
  g.step_px = static_cast<double>(camera.width_px - 1) / (kColumns - 1);
  g.rows = std::max(2, static_cast<int>((camera.height_px - 1) / g.step_px) + 1);
  for (int r = 0; r < g.rows; ++r)
    for (int c = 0; c < g.columns; ++c) {
      const auto ray = unproject_ray(camera, {c * g.step_px, r * g.step_px});
      g.ray.push_back(ray ? Eigen::Vector3d(ray->x, ray->y, ray->z).normalized() : Eigen::Vector3d::Zero());
    }
  return g;
}

using Jet = ceres::Jet<double, kCameraParameters + 3>;
/// Pixel, its derivatives by the intrinsics, and by a rotation of the ray. False: no such pixel.
bool derivatives(const CameraModel& camera, const Eigen::Vector3d& ray, Eigen::Vector2d& q,
                 Eigen::Matrix<double, 2, kCameraParameters>& by_camera,
                 Eigen::Matrix<double, 2, 3>& by_rotation) {
  const auto values = camera_parameters(camera);
  std::array<Jet, kCameraParameters> jets;
  for (int i = 0; i < kCameraParameters; ++i)
    jets[static_cast<std::size_t>(i)] = Jet(values[static_cast<std::size_t>(i)], i);
  // p + w × p for a small rotation w.
  Jet w[3], p[3];
  for (int i = 0; i < 3; ++i) w[i] = Jet(0.0, kCameraParameters + i);
  p[0] = ray.x() + w[1] * ray.z() - w[2] * ray.y();
  p[1] = ray.y() + w[2] * ray.x() - w[0] * ray.z();
  p[2] = ray.z() + w[0] * ray.y() - w[1] * ray.x();
  Jet u, v;
  if (!project_point(jets.data(), p, camera.projection == Projection::kannala_brandt, kThetaMax, Jet(1.0), u,
                     v))
    return false;
  q = {u.a, v.a};
  by_camera.row(0) = u.v.head<kCameraParameters>().transpose();
  by_camera.row(1) = v.v.head<kCameraParameters>().transpose();
  by_rotation.row(0) = u.v.tail<3>().transpose();
  by_rotation.row(1) = v.v.tail<3>().transpose();
  return q.allFinite() && by_camera.allFinite();
}

}  // namespace

UncertaintyMap uncertainty_map(const CameraModel& camera, const Eigen::MatrixXd& covariance) {
  const Grid g = grid_of(camera);
  UncertaintyMap map{g.columns, g.rows, g.step_px, {}};
  const std::size_t n = g.ray.size();
  std::vector<Eigen::Matrix<double, 2, kCameraParameters>> j(n);
  std::vector<Eigen::Matrix<double, 2, 3>> a(n);
  std::vector<bool> good(n, false);
  Eigen::Matrix3d normal = Eigen::Matrix3d::Zero();
  Eigen::Matrix<double, 3, kCameraParameters> right = Eigen::Matrix<double, 3, kCameraParameters>::Zero();
  for (std::size_t i = 0; i < n; ++i) {
    Eigen::Vector2d q;
    good[i] = !g.ray[i].isZero() && derivatives(camera, g.ray[i], q, j[i], a[i]);
    if (!good[i]) continue;
    normal += a[i].transpose() * a[i];
    right += a[i].transpose() * j[i];
  }
  // The rotation that a change of the intrinsics would be answered with: the boards' poses do the same.
  const Eigen::Matrix<double, 3, kCameraParameters> answer = normal.ldlt().solve(right);
  for (std::size_t i = 0; i < n; ++i) {
    if (!good[i]) {
      map.sigma_px.push_back(std::numeric_limits<double>::quiet_NaN());
      continue;
    }
    const Eigen::Matrix<double, 2, kCameraParameters> rest = j[i] - a[i] * answer;
    Eigen::MatrixXd c = covariance;
    Eigen::Matrix2d variance = Eigen::Matrix2d::Zero();
    bool infinite = false;
    for (int k = 0; k < kCameraParameters; ++k)
      if (!std::isfinite(c(k, k))) infinite = infinite || rest.col(k).norm() > 0, c(k, k) = 0;
    variance = rest * c * rest.transpose();
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> eigen(variance);
    map.sigma_px.push_back(infinite ? std::numeric_limits<double>::infinity()
                                    : std::sqrt(std::max(0.0, eigen.eigenvalues()[1])));
  }
  return map;
}

double projection_difference_p95_px(const CameraModel& a, const CameraModel& b) {
  const Grid g = grid_of(a);
  Eigen::Matrix3d rotation = Eigen::Matrix3d::Identity();
  std::vector<double> apart;
  for (int round = 0; round < 5; ++round) {
    Eigen::Matrix3d normal = Eigen::Matrix3d::Zero();
    Eigen::Vector3d right = Eigen::Vector3d::Zero();
    apart.clear();
    for (int r = 0; r < g.rows; ++r)
      for (int c = 0; c < g.columns; ++c) {
        const Eigen::Vector3d& ray = g.ray[static_cast<std::size_t>(r * g.columns + c)];
        if (ray.isZero()) continue;
        Eigen::Vector2d q;
        Eigen::Matrix<double, 2, kCameraParameters> by_camera;
        Eigen::Matrix<double, 2, 3> by_rotation;
        if (!derivatives(b, rotation * ray, q, by_camera, by_rotation)) continue;
        const Eigen::Vector2d e = q - Eigen::Vector2d(c * g.step_px, r * g.step_px);
        apart.push_back(e.norm());
        // Far outliers at the edge would turn the whole picture.
        const double weight = 1 / (1 + e.squaredNorm());
        normal += weight * by_rotation.transpose() * by_rotation;
        right -= weight * by_rotation.transpose() * e;
      }
    if (apart.empty()) return std::numeric_limits<double>::infinity();
    const Eigen::Vector3d w = normal.ldlt().solve(right);
    const double angle = w.norm();
    if (angle > 1e-12) rotation = Eigen::AngleAxisd(angle, w / angle).toRotationMatrix() * rotation;
  }
  const auto k = static_cast<std::ptrdiff_t>(0.95 * static_cast<double>(apart.size()));
  std::nth_element(apart.begin(), apart.begin() + k, apart.end());
  return apart[static_cast<std::size_t>(k)];
}

}  // namespace rigor::calibration
