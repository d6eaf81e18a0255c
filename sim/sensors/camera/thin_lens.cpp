#include "sim/sensors/camera/thin_lens.h"

#include <cmath>
#include <limits>

namespace rigor {

ThinLens ThinLens::of(const CameraModel& camera, int channel) {
  ThinLens lens;
  lens.fisheye = camera.projection == Projection::kannala_brandt;
  if (!camera.depth_of_field.active()) return lens;
  lens.focus_m = focus_distance_m(camera, channel);
  lens.diameter_at_far_px = blur_diameter_px(camera, std::numeric_limits<double>::infinity(), channel);
  lens.radius_m = 0.5 * lens.diameter_at_far_px * lens.focus_m / camera.fx_px;
  return lens;
}

double ThinLens::diameter_px(double d_m) const {
  if (!opens()) return 0;
  if (!(d_m < 1e30)) return diameter_at_far_px;
  return diameter_at_far_px * std::abs(d_m - focus_m) / d_m;
}

}  // namespace rigor
