// A board that a hand moves before a camera with a rolling shutter.
#pragma once

#include <optional>

#include "tests/calibration/camera/board_scene.h"

namespace rigor::calibration::test {

inline const Board kMovingBoard{BoardKind::chessboard, 6, 5, 0.035};

/// A hand that turns and shifts the board: two sines for each of the six numbers, up to 1.5 Hz.
struct Motion {
  double amplitude[6][2], rate[6][2], phase[6][2];
  explicit Motion(std::mt19937& random, double size = 1) {
    std::uniform_real_distribution<double> unit(0, 1);
    constexpr double kSize[6] = {0.35, 0.35, 0.25, 0.10, 0.06, 0.08};
    for (int i = 0; i < 6; ++i)
      for (int k = 0; k < 2; ++k) {
        amplitude[i][k] = size * kSize[i] * (0.5 + 0.5 * unit(random)) / (1 + k);
        rate[i][k] = 2 * std::numbers::pi * (k == 0 ? 0.3 + 0.3 * unit(random) : 0.8 + 0.7 * unit(random));
        phase[i][k] = 2 * std::numbers::pi * unit(random);
      }
  }
  [[nodiscard]] Eigen::Isometry3d at(double t_s, const Board& board) const {
    double p[6] = {0, 0, 0, 0, 0, 0.42};
    for (int i = 0; i < 6; ++i)
      for (int k = 0; k < 2; ++k) p[i] += amplitude[i][k] * std::sin(rate[i][k] * t_s + phase[i][k]);
    const Eigen::Vector3d w(p[0], p[1], p[2]);
    Eigen::Isometry3d t = Eigen::Isometry3d::Identity();
    t.linear() = Eigen::AngleAxisd(w.norm(), w.normalized()).toRotationMatrix();
    t.translation() = Eigen::Vector3d(p[3], p[4], p[5]) -
                      t.linear() * Eigen::Vector3d((board.columns - 1) * board.spacing_m / 2,
                                                   (board.rows - 1) * board.spacing_m / 2, 0);
    return t;
  }
};

/// Each corner where it was when the row on which it falls was read.
inline BoardView rolling_view(const CameraModel& camera, const Board& board, const Motion& motion, double t_s,
                              const std::string& name) {
  BoardView view{name, camera.width_px, camera.height_px, {}, t_s};
  for (int row = 0; row < board.rows; ++row)
    for (int column = 0; column < board.columns; ++column) {
      double v_px = 0.5 * (camera.height_px - 1);
      std::optional<PixelPosition> q;
      for (int round = 0; round < 20; ++round) {
        const Eigen::Vector3d p = motion.at(t_s + row_delay_s(camera, v_px), board) *
                                  Eigen::Vector3d(column * board.spacing_m, row * board.spacing_m, 0);
        q = project_ray(camera, {p.x(), p.y(), p.z()});
        if (!q) break;
        v_px = q->v_px;
      }
      if (!q || q->u_px < 0 || q->v_px < 0 || q->u_px > camera.width_px - 1 || q->v_px > camera.height_px - 1)
        continue;
      view.points.push_back({column, row, column * board.spacing_m, row * board.spacing_m, q->u_px, q->v_px});
    }
  return view;
}

inline std::vector<BoardView> moving_board_views(const CameraModel& camera, std::uint32_t seed,
                                                 double motion = 1, double noise_px = 0.1,
                                                 int pictures = 24) {
  const Board& board = kMovingBoard;
  std::mt19937 random(seed);
  const Motion hand(random, motion);
  std::vector<BoardView> views;
  for (int i = 0; i < pictures; ++i) {
    auto view = rolling_view(camera, board, hand, i / 30.0, "picture " + std::to_string(i));
    if (view.points.size() < 12) continue;
    add_noise(view, noise_px, random);
    views.push_back(std::move(view));
  }
  return views;
}

}  // namespace rigor::calibration::test
