#include "bench/sensing/camera_info.h"

namespace rigor {

record::msg::CameraInfo camera_info(const CameraModel& m) {
  record::msg::CameraInfo info;
  info.width = static_cast<std::uint32_t>(m.width_px);
  info.height = static_cast<std::uint32_t>(m.height_px);
  if (m.projection == Projection::kannala_brandt) {
    info.distortion_model = "equidistant";
    info.d = {m.fisheye.k1, m.fisheye.k2, m.fisheye.k3, m.fisheye.k4};
  } else {
    info.distortion_model = "rational_polynomial";
    info.d = {m.lens.k1, m.lens.k2, m.lens.p1, m.lens.p2, m.lens.k3, m.lens.k4, m.lens.k5, m.lens.k6};
  }
  info.k = {m.fx_px, 0, m.cx_px, 0, m.fy_px, m.cy_px, 0, 0, 1};
  info.r = {1, 0, 0, 0, 1, 0, 0, 0, 1};
  info.p = {m.fx_px, 0, m.cx_px, 0, 0, m.fy_px, m.cy_px, 0, 0, 0, 1, 0};
  return info;
}

}  // namespace rigor
