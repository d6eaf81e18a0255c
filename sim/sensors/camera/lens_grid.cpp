#include "sim/sensors/camera/lens_grid.h"

#include <tbb/parallel_for.h>

#include <cmath>

#include "sensor-hal/models/lens_walk.h"

namespace rigor {

using Lens = models::LensMath<double>;

Eigen::Vector2d image_of(const CameraModel& camera, const Eigen::Vector3d& direction, int channel) {
  const double m = channel < 0 ? 1.0 : camera.chromatic.magnification[static_cast<std::size_t>(channel)];
  double xd = 0, yd = 0;
  if (camera.projection == Projection::kannala_brandt) {
    const auto& l = camera.fisheye;
    const double across = std::hypot(direction.x(), direction.y());
    const double radius = Lens::fisheye_radius(std::atan2(across, direction.z()), l.k1, l.k2, l.k3, l.k4);
    const double scale = across > 0 ? radius / across : 0.0;
    xd = direction.x() * scale;
    yd = direction.y() * scale;
  } else {
    const OpenCvLens& l = camera.lens;
    Lens::lens_distort(direction.x() / direction.z(), direction.y() / direction.z(), l.k1, l.k2, l.p1, l.p2,
                       l.k3, l.k4, l.k5, l.k6, xd, yd);
  }
  return {camera.cx_px + m * camera.fx_px * xd, camera.cy_px + m * camera.fy_px * yd};
}

LensGrid::LensGrid(const CameraModel& camera, int channel, int border_px)
    : border_px_(border_px),
      width_px_(camera.width_px + 2 * border_px),
      height_px_(camera.height_px + 2 * border_px),
      pixels_(static_cast<std::size_t>(width_px_) * static_cast<std::size_t>(height_px_)) {
  tbb::parallel_for(0, height_px_, [&](int v) {
    LensWalk walk(camera, channel);
    for (int u = 0; u < width_px_; ++u) {
      Eigen::Vector3f& to = pixels_[static_cast<std::size_t>(v) * static_cast<std::size_t>(width_px_) +
                                    static_cast<std::size_t>(u)]
                                .ray;
      const PixelPosition pixel{static_cast<double>(u - border_px_), static_cast<double>(v - border_px_)};
      if (camera.projection == Projection::opencv) {
        if (const auto p = walk(pixel)) to = Eigen::Vector3d(p->x, p->y, 1).normalized().cast<float>();
      } else if (const auto ray = unproject_ray(camera, pixel, channel)) {
        to = Eigen::Vector3d(ray->x, ray->y, ray->z).normalized().cast<float>();
      }
    }
  });
  const auto slope = [&](int u, int v, int du, int dv) -> Eigen::Vector3f {
    const auto get = [&](int x, int y) -> const Pixel* {
      if (x < 0 || y < 0 || x >= width_px_ || y >= height_px_) return nullptr;
      const Pixel& p = pixels_[static_cast<std::size_t>(y) * static_cast<std::size_t>(width_px_) +
                               static_cast<std::size_t>(x)];
      return p.lit() ? &p : nullptr;
    };
    const Pixel *here = get(u, v), *before = get(u - du, v - dv), *after = get(u + du, v + dv);
    if (here == nullptr) return Eigen::Vector3f::Zero();
    if (before != nullptr && after != nullptr) return 0.5F * (after->ray - before->ray);
    if (after != nullptr) return after->ray - here->ray;
    if (before != nullptr) return here->ray - before->ray;
    return Eigen::Vector3f::Zero();
  };
  tbb::parallel_for(0, height_px_, [&](int v) {
    for (int u = 0; u < width_px_; ++u) {
      Pixel& p = pixels_[static_cast<std::size_t>(v) * static_cast<std::size_t>(width_px_) +
                         static_cast<std::size_t>(u)];
      p.du = slope(u, v, 1, 0);
      p.dv = slope(u, v, 0, 1);
    }
  });
}

}  // namespace rigor
