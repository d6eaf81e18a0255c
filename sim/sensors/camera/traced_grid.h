// The grid of pixels that rays are traced for where the planes of a picture are taken from another one:
// coarser by a step, and larger by a border, than the sensor. Internal to sim/sensors/camera.
#pragma once

#include "sim/sensors/camera/camera_optics_picture.h"
#include "sim/sensors/camera/lens_grid.h"

namespace rigor {

class TracedGrid {
 public:
  /// The sensor's own pixels.
  explicit TracedGrid(const CameraModel& camera) : camera_(camera), sensor_(camera) {}
  /// Of `step` x `step` pixels of the sensor each: pixel (i, j) lies in the middle of those from (step · i,
  /// step · j) on. With a border as wide as lateral chromatic aberration looks beyond the sensor.
  TracedGrid(const CameraModel& camera, int step);
  /// Whether such a border is small enough to be worth its rays.
  [[nodiscard]] static bool fits(const CameraModel& camera, int step);

  /// The lens over the grid, without its border.
  [[nodiscard]] const CameraModel& camera() const { return camera_; }
  [[nodiscard]] int border_px() const { return border_; }
  [[nodiscard]] int width_px() const { return camera_.width_px + 2 * border_; }
  [[nodiscard]] int height_px() const { return camera_.height_px + 2 * border_; }
  /// Row of the sensor whose exposure a row of the grid has.
  [[nodiscard]] int row_of(int v) const { return (v - border_) * step_ + step_ / 2; }
  /// Part of the grid where the colours' places within `region` of the sensor lie.
  [[nodiscard]] OpticsRequest::Region looked_at(const OpticsRequest::Region& region) const;
  /// Takes the planes of `region` of the sensor from a picture of the grid, bilinearly. `reference` holds
  /// `traced`, a part of the grid; `lens`: over the grid.
  void move_colours(const OpticsPicture& reference, const OpticsRequest::Region& traced, const LensGrid& lens,
                    const OpticsRequest::Region& region, OpticsPicture& out) const;

 private:
  /// Where a place on the sensor lies in the grid.
  [[nodiscard]] double traced_at(double p) const { return (p - 0.5 * (step_ - 1)) / step_ + border_; }

  CameraModel camera_, sensor_;
  int step_ = 1, border_ = 0;
};

}  // namespace rigor
