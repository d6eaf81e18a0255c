// The ideal rays of all pixels, worked out once: which way the light comes that a pixel sees, and how that
// changes within it. Internal to sim/sensors/camera.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "sensor-hal/models/camera_model.h"

namespace rigor {

/// Where light of a colour from a direction falls, without asking whether the lens folds there: for
/// directions near one that `unproject_ray` gave.
[[nodiscard]] Eigen::Vector2d image_of(const CameraModel& camera, const Eigen::Vector3d& direction,
                                       int channel = kReferenceChannel);

class LensGrid {
 public:
  struct Pixel {
    Eigen::Vector3f ray = Eigen::Vector3f::Zero();  ///< unit length, optical frame; 0: no light
    Eigen::Vector3f du = ray, dv = ray;             ///< change per pixel to the right, downwards
    [[nodiscard]] bool lit() const { return ray != Eigen::Vector3f::Zero(); }
    [[nodiscard]] Eigen::Vector3f at(float u, float v) const { return (ray + u * du + v * dv).normalized(); }
  };
  /// Of a colour (see unproject_ray), with `border_px` more on each side than the sensor has.
  LensGrid(const CameraModel& camera, int channel, int border_px = 0);

  [[nodiscard]] int border_px() const { return border_px_; }
  [[nodiscard]] int width_px() const { return width_px_; }    ///< with the border
  [[nodiscard]] int height_px() const { return height_px_; }  ///< with the border
  /// By the sensor's own column and row, −border … size + border − 1.
  [[nodiscard]] const Pixel& at(int u, int v) const {
    return pixels_[static_cast<std::size_t>(v + border_px_) * static_cast<std::size_t>(width_px_) +
                   static_cast<std::size_t>(u + border_px_)];
  }
  [[nodiscard]] const std::vector<Pixel>& pixels() const { return pixels_; }

 private:
  int border_px_, width_px_, height_px_;
  std::vector<Pixel> pixels_;
};

}  // namespace rigor
