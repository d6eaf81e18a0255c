// Undoes the lens for pixels that follow each other: rows of a table.
//
//   LensWalk walk(camera);                       // one for each row, so that no row depends on another
//   for (int u = 0; u < width; ++u) p = walk({u, v});
//
// From the last position by Newton's iteration, which stays on its branch over such steps; where that does
// not end at once, unproject_ray() decides. Its answers agree with those to 1e-12.
#pragma once

#include <optional>

#include "sensor-hal/models/camera_model.h"
#include "sensor-hal/models/one_source.h"

namespace rigor {

class LensWalk {
 public:
  /// `camera` outlives this. `channel`: a colour, see unproject_ray().
  explicit LensWalk(const CameraModel& camera, int channel = kReferenceChannel)
      : camera_(camera),
        channel_(channel),
        magnification_(channel < 0 ? 1.0
                                   : camera.chromatic.magnification[static_cast<std::size_t>(channel)]) {}

  /// Where the pixel's ray crosses z = 1; nothing where there is none, or none in front.
  std::optional<NormalisedPosition> operator()(const PixelPosition& pixel) {
    if (camera_.projection == Projection::opencv) {
      const double xd = (pixel.u_px - camera_.cx_px) / camera_.fx_px / magnification_,
                   yd = (pixel.v_px - camera_.cy_px) / camera_.fy_px / magnification_;
      if (camera_.lens == OpenCvLens{}) return NormalisedPosition{xd, yd};
      if (last_)
        if (const auto near = step(xd, yd, *last_)) return last_ = near;
    }
    const auto ray = unproject_ray(camera_, pixel, channel_);
    last_.reset();
    if (ray && ray->z > 0) last_ = NormalisedPosition{ray->x / ray->z, ray->y / ray->z};
    return last_;
  }

 private:
  [[nodiscard]] std::optional<NormalisedPosition> step(double xd, double yd, NormalisedPosition p) const {
    const OpenCvLens& l = camera_.lens;
    for (int i = 0; i < 8; ++i) {
      double ex = 0, ey = 0, jxx = 0, jxy = 0, jyx = 0, jyy = 0, den = 0;
      models::LensMath<double>::lens_distort_jacobian(p.x, p.y, l.k1, l.k2, l.p1, l.p2, l.k3, l.k4, l.k5,
                                                      l.k6, ex, ey, jxx, jxy, jyx, jyy, den);
      ex -= xd;
      ey -= yd;
      const double det = jxx * jyy - jxy * jyx;
      if (!(det > 0.05) || !(den > 0.05) || !(jxx + jyy > 0)) return std::nullopt;
      if (ex * ex + ey * ey < 1e-26 * (1 + xd * xd + yd * yd)) return p;
      p.x -= (jyy * ex - jxy * ey) / det;
      p.y -= (jxx * ey - jyx * ex) / det;
    }
    return std::nullopt;
  }

  const CameraModel& camera_;
  int channel_;
  double magnification_;
  std::optional<NormalisedPosition> last_;
};

}  // namespace rigor
