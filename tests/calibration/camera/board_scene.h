// Boards before simulated cameras: views through the simulator's own lens model, with noise on the corners.
#pragma once

#include <Eigen/Geometry>
#include <cmath>
#include <numbers>
#include <random>
#include <string>
#include <vector>

#include "calibration/camera/board.h"
#include "calibration/camera/camera_fit.h"
#include "sensor-hal/models/camera_model.h"
#include "sim/world/pose.h"

namespace rigor::calibration::test {

/// The camera whose coefficients a model has, all of them far from 0.
inline CameraModel true_camera(LensModel model) {
  CameraModel c;
  c.width_px = 640, c.height_px = 480;
  c.fx_px = 535, c.fy_px = 533, c.cx_px = 322.5, c.cy_px = 236;
  if (model == LensModel::fisheye4) {
    c.projection = Projection::kannala_brandt;
    c.fx_px = 245, c.fy_px = 244;
    c.fisheye = {0.03, -0.012, 0.006, -0.002};
  } else if (model == LensModel::opencv8) {
    // A wide lens: what k4 … k6 are for.
    c.fx_px = 220, c.fy_px = 219;
    c.lens = {0.25, 0.05, 5e-4, -3e-4, 0.02, 0.55, 0.12, 0.03};
  } else {
    if (model >= LensModel::opencv2) c.lens.k1 = -0.28, c.lens.k2 = 0.09;
    if (model >= LensModel::opencv4) c.lens.p1 = 1e-3, c.lens.p2 = -4e-4;
    if (model >= LensModel::opencv5) c.lens.k3 = -0.05;
  }
  return c;
}

struct Scene {
  Board board{BoardKind::chessboard, 9, 6, 0.03};
  int views = 12;
  double noise_px = 0.1;
  double tilt_max_rad = 0.7, tilt_min_rad = 0.15;
  double nearest_m = 0.3, farthest_m = 0.8;
  bool all_corners_seen = true;  ///< else those that fall into the picture
};

/// T_camera_board with the board's middle on the ray of a random pixel.
inline Eigen::Isometry3d random_pose(const CameraModel& camera, const Scene& s, std::mt19937& random) {
  std::uniform_real_distribution<double> unit(0, 1);
  const PixelPosition at{unit(random) * (camera.width_px - 1), unit(random) * (camera.height_px - 1)};
  const auto ray = unproject_ray(camera, at);
  const double distance = s.nearest_m + (s.farthest_m - s.nearest_m) * unit(random);
  const double about = 2 * std::numbers::pi * unit(random);
  const double tilt = s.tilt_min_rad + (s.tilt_max_rad - s.tilt_min_rad) * unit(random);
  const double turn = 0.5 * (unit(random) - 0.5);
  Eigen::Isometry3d t = Eigen::Isometry3d::Identity();
  if (!ray) return t;
  const Eigen::Vector3d direction(ray->x, ray->y, ray->z);
  // Facing the camera from where it is, then tilted.
  const Eigen::Quaterniond facing = rotation_between(Eigen::Vector3d::UnitZ(), direction);
  t.linear() = (facing * Eigen::AngleAxisd(tilt, Eigen::Vector3d(std::cos(about), std::sin(about), 0)) *
                Eigen::AngleAxisd(turn, Eigen::Vector3d::UnitZ()))
                   .toRotationMatrix();
  const Eigen::Vector3d middle((s.board.columns - 1) * s.board.spacing_m / 2,
                               (s.board.rows - 1) * s.board.spacing_m / 2, 0);
  t.translation() = distance * direction - t.linear() * middle;
  return t;
}

inline BoardView view_of(const CameraModel& camera, const Board& board,
                         const Eigen::Isometry3d& T_camera_board, const std::string& name) {
  BoardView view{name, camera.width_px, camera.height_px, {}};
  for (int row = 0; row < board.rows; ++row)
    for (int column = 0; column < board.columns; ++column) {
      const Eigen::Vector3d p =
          T_camera_board * Eigen::Vector3d(column * board.spacing_m, row * board.spacing_m, 0);
      const auto q = project_ray(camera, {p.x(), p.y(), p.z()});
      if (!q || q->u_px < -0.5 || q->v_px < -0.5 || q->u_px > camera.width_px - 0.5 ||
          q->v_px > camera.height_px - 0.5)
        continue;
      view.points.push_back({column, row, column * board.spacing_m, row * board.spacing_m, q->u_px, q->v_px});
    }
  return view;
}

inline void add_noise(BoardView& view, double sigma_px, std::mt19937& random) {
  std::normal_distribution<double> noise(0, sigma_px);
  for (BoardPoint& p : view.points) p.u_px += noise(random), p.v_px += noise(random);
}

/// Views of random poses, with noise.
inline std::vector<BoardView> random_views(const CameraModel& camera, const Scene& s, std::uint32_t seed) {
  std::mt19937 random(seed);
  std::vector<BoardView> views;
  const auto all = static_cast<std::size_t>(s.board.columns * s.board.rows);
  for (int tries = 0; static_cast<int>(views.size()) < s.views && tries < 100 * s.views; ++tries) {
    auto view =
        view_of(camera, s.board, random_pose(camera, s, random), "view " + std::to_string(views.size()));
    if (s.all_corners_seen ? view.points.size() < all : view.points.size() < 12) continue;
    add_noise(view, s.noise_px, random);
    views.push_back(std::move(view));
  }
  return views;
}

/// The true value of a parameter by its name.
inline double true_value(const CameraModel& c, const std::string& name) {
  if (name == "fx_px") return c.fx_px;
  if (name == "fy_px") return c.fy_px;
  if (name == "cx_px") return c.cx_px;
  if (name == "cy_px") return c.cy_px;
  const bool fisheye = c.projection == Projection::kannala_brandt;
  if (name == "k1") return fisheye ? c.fisheye.k1 : c.lens.k1;
  if (name == "k2") return fisheye ? c.fisheye.k2 : c.lens.k2;
  if (name == "k3") return fisheye ? c.fisheye.k3 : c.lens.k3;
  if (name == "k4") return fisheye ? c.fisheye.k4 : c.lens.k4;
  if (name == "p1") return c.lens.p1;
  if (name == "p2") return c.lens.p2;
  if (name == "k5") return c.lens.k5;
  if (name == "k6") return c.lens.k6;
  return std::nan("");
}

/// What 100 repetitions say of the uncertainty that a fit states.
struct Judged {
  double chi_squared = 0;
  int degrees = 0;
  int covered = 0, intervals = 0;

  /// Adds a fit whose errors are `error` = value − truth, in the order of its parameters.
  void add(const FitResult& fit, const Eigen::VectorXd& error) {
    const auto n = error.size();
    Eigen::VectorXd unit(n);
    for (Eigen::Index i = 0; i < n; ++i) {
      const double sigma = fit.parameters[static_cast<std::size_t>(i)].sigma;
      unit[i] = error[i] / sigma;
      covered += std::abs(unit[i]) <= 1.959964;
      ++intervals;
    }
    Eigen::MatrixXd correlation = fit.covariance;
    for (Eigen::Index i = 0; i < n; ++i)
      for (Eigen::Index k = 0; k < n; ++k)
        correlation(i, k) /= fit.parameters[static_cast<std::size_t>(i)].sigma *
                             fit.parameters[static_cast<std::size_t>(k)].sigma;
    chi_squared += unit.dot(correlation.ldlt().solve(unit));
    degrees += static_cast<int>(n);
  }
  /// χ² of so many degrees in standard deviations from its mean, after Wilson and Hilferty: normal.
  [[nodiscard]] double chi_squared_normal() const {
    const double d = degrees;
    return (std::cbrt(chi_squared / d) - (1 - 2 / (9 * d))) / std::sqrt(2 / (9 * d));
  }
  /// Of 95 % in standard deviations of the binomial distribution.
  [[nodiscard]] double coverage_normal() const {
    return (covered - 0.95 * intervals) / std::sqrt(intervals * 0.95 * 0.05);
  }
};
inline constexpr double kTwoSided001 = 3.2905;  ///< of a normal distribution, 0.001 outside

}  // namespace rigor::calibration::test
