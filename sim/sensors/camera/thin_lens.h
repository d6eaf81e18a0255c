// The lens' opening: where it sits on a ray, and how wide the picture of a point out of focus is. Internal to
// sim/sensors/camera.
#pragma once

#include <Eigen/Geometry>

#include "sim/sensors/camera/lens_grid.h"

namespace rigor {

/// A thin lens that keeps to the blur diameter f²·|d − U| / (N·C·d·(U − f)), whatever else the model's focal
/// lengths say: its opening is the one that gives this at fx. d is depth for lenses of OpenCV's model, so
/// that planes are in focus, and range for fisheyes, whose rays may run sideways; their opening faces each
/// ray.
struct ThinLens {
  double focus_m = 0;             ///< 0: a pinhole
  double diameter_at_far_px = 0;  ///< of the picture of a point infinitely far away
  double radius_m = 0;            ///< of the opening
  bool fisheye = false;

  [[nodiscard]] static ThinLens of(const CameraModel& camera, int channel);
  [[nodiscard]] bool opens() const { return radius_m > 0; }
  /// Picture of a point at a depth (fisheye: range), px.
  [[nodiscard]] double diameter_px(double d_m) const;
  /// Moves a ray through the middle of the lens to a place of its opening. All in the optical frame.
  void refract(float lens_x, float lens_y, Eigen::Vector3f& direction, Eigen::Vector3f& origin) const {
    const auto focus = static_cast<float>(focus_m), radius = static_cast<float>(radius_m);
    if (fisheye) {
      const Eigen::Vector3f across = direction.unitOrthogonal(), down = direction.cross(across);
      origin = radius * (lens_x * across + lens_y * down);
      direction = (focus * direction - origin).normalized();
    } else {
      origin = {radius * lens_x, radius * lens_y, 0};
      direction = (focus / direction.z() * direction - origin).normalized();
    }
  }
};

}  // namespace rigor
