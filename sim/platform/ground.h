// The ground under a vehicle: the terrain of the world on its finest level, or a level plane.
#pragma once

#include <Eigen/Core>
#include <array>
#include <memory>
#include <span>
#include <vector>

#include "sim/render/content/provider.h"

namespace rigor {

/// Immutable; any thread, no allocation.
class Ground {
 public:
  /// A level plane.
  explicit Ground(double level_m = 0) : level_m_(level_m) {}
  /// The terrain, bilinear between the heights of its finest grid.
  explicit Ground(std::shared_ptr<const render::GroundHeights> terrain) : terrain_(std::move(terrain)) {}

  /// z; NaN where the terrain does not reach or has a hole.
  [[nodiscard]] double height_m(double x_m, double y_m) const {
    return terrain_ ? terrain_->height_at(x_m, y_m) : level_m_;
  }
  /// Upward, unit length: of the bilinear patch there, of both together on the border between two. NaN as
  /// above.
  [[nodiscard]] Eigen::Vector3d normal(double x_m, double y_m) const;

 private:
  std::shared_ptr<const render::GroundHeights> terrain_;
  double level_m_ = 0;
};

/// A vehicle's wheels on the ground.
class Footprint {
 public:
  /// Where the wheels touch, in the vehicle's frame. Precondition: at least three, not in a line.
  explicit Footprint(std::span<const Eigen::Vector2d> wheels_m);

  struct Stand {
    double z_m = 0;                      ///< of the plane under the origin
    double roll_rad = 0, pitch_rad = 0;  ///< R = Rz(yaw)·Ry(pitch)·Rx(roll); positive pitch: nose down
  };
  /// The plane that fits the ground under the wheels best (least squares in z). The wheels' places are turned
  /// by the yaw alone: a slope does not draw them together. NaN where one of them has no ground.
  [[nodiscard]] Stand stand(const Ground& ground, double x_m, double y_m, double yaw_rad) const;

 private:
  static constexpr std::size_t kMost = 8;
  std::size_t count_ = 0;
  std::array<Eigen::Vector2d, kMost> wheel_m_{};
  std::array<Eigen::Vector3d, kMost>
      weight_{};  ///< of a wheel's height in level, slope along x, slope along y
};

}  // namespace rigor
