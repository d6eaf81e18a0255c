// From the pinhole picture to the pixels of the sensor: where each of them looks, and the light there.
// Internal to sim/render/scene.
#pragma once

#include <array>
#include <vector>

#include "rt-core/result.h"
#include "sensor-hal/models/camera_model.h"
#include "sim/render/scene/scene_frame.h"
#include "sim/render/scene/scene_picture.h"

namespace rigor::render {

class LensSampler {
 public:
  /// Setup: a microsecond a pixel, on all threads. `supersampling`: picture pixels per sensor pixel along one
  /// side, on the axis. Errors: bad_input (no light reaches a pixel; a lens wider than a pinhole picture can
  /// hold).
  [[nodiscard]] static Result<LensSampler> create(const CameraModel& camera, double supersampling);

  [[nodiscard]] const PictureGeometry& picture() const { return picture_; }
  /// Rows beside the picture that stay dark: pixels that no light reaches look there.
  static constexpr int kDarkRows = 8;
  /// What of the picture the pixels of a region look at.
  [[nodiscard]] PictureArea seen_by(int x_px, int y_px, int width_px, int height_px) const;
  /// Mean of each of `count` pixels from (x, y) of the sensor on: bilinear, over taps² places of the pixel.
  /// The light of even columns of the sensor is in `even`, that of odd ones in `odd`.
  void sample(int x_px, int y_px, int count, const float* even, const float* odd, float* out) const;
  /// The ideal ray (x/z, y/z) of each pixel; no number where the lens images none.
  [[nodiscard]] std::vector<std::array<float, 2>> rays() const;

 private:
  int width_px_ = 0, height_px_ = 0, taps_ = 1;
  float tap_px_ = 0;  ///< distance of the taps
  PictureGeometry picture_;
  std::vector<float> u_, v_;  ///< where in the picture, pixel by pixel
};

}  // namespace rigor::render
