#include "sim/sensors/tof/tof_returns.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "sensor-hal/models/lidar/lidar_math.h"
#include "sensor-hal/models/one_source.h"
#include "sensor-hal/models/wide.h"
#include "sim/sensors/tof/tof_light_math.h"

namespace rigor::tof {
namespace {

struct Camera {
  float R[9], eye[3];  ///< world to sensor, row by row
  float fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6;
};
struct Points {
  const float* __restrict x, * __restrict y, * __restrict z, * __restrict met, * __restrict nx, * __restrict ny, * __restrict nz, * __restrict diffuse, * __restrict retro, * __restrict alpha2, * __restrict f0;
};
struct Places {
  float* __restrict u, * __restrict v, * __restrict range_m, * __restrict remission, * __restrict off_axis_cos, * __restrict rise;
};

RIGOR_WIDE void see_points(const Points p, const Camera c, std::size_t begin, std::size_t end,
                           const Places to) {
  constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();
  for (std::size_t i = begin; i < end; ++i) {
    const float dx = p.x[i] - p.met[i] * c.eye[0], dy = p.y[i] - p.met[i] * c.eye[1],
                dz = p.z[i] - p.met[i] * c.eye[2];
    const float range_m = std::sqrt(dx * dx + dy * dy + dz * dz), per = 1 / range_m;
    const float cosine = -(p.nx[i] * dx + p.ny[i] * dy + p.nz[i] * dz) * per;
    const float sx = c.R[0] * dx + c.R[1] * dy + c.R[2] * dz, sy = c.R[3] * dx + c.R[4] * dy + c.R[5] * dz,
                sz = c.R[6] * dx + c.R[7] * dy + c.R[8] * dz;
    float x = 0, y = 0, xx = 0, xy = 0, yx = 0, yy = 0, den = 0;
    models::LensMath<float>::lens_distort_jacobian(sx / sz, sy / sz, c.k1, c.k2, c.p1, c.p2, c.k3, c.k4, c.k5,
                                                   c.k6, x, y, xx, xy, yx, yy, den);
    // Not behind the sensor, nor beyond the fold of the lens.
    const bool seen = (sz > 0) & (xx * yy - xy * yx > 0) & (den > 0) & (range_m > 1e-3F);
    to.u[i] = seen ? c.fx * x + c.cx : kNaN;
    to.v[i] = c.fy * y + c.cy;
    to.range_m[i] = range_m;
    const float c_hit = cosine > 0 ? (cosine < 1 ? cosine : 1.0F) : 0.0F;
    to.remission[i] = p.diffuse[i] * c_hit + p.retro[i] +
                      models::LidarMath<float>::lidar_highlight(c_hit, p.alpha2[i], p.f0[i]);
    to.off_axis_cos[i] = sz * per;
    to.rise[i] = dz * per;
  }
}

}  // namespace

void Returns::set(std::size_t i, const render::Ray& ray, const render::Hit& hit, double retro_gain) {
  const bool nothing = hit.nothing();
  const float range_m = nothing ? 1.0F : hit.range_m;
  x_[i] = (nothing ? 0.0F : ray.origin[0]) + range_m * ray.direction[0];
  y_[i] = (nothing ? 0.0F : ray.origin[1]) + range_m * ray.direction[1];
  z_[i] = (nothing ? 0.0F : ray.origin[2]) + range_m * ray.direction[2];
  met_[i] = nothing ? 0.0F : 1.0F;
  nx_[i] = hit.normal[0], ny_[i] = hit.normal[1], nz_[i] = hit.normal[2];
  diffuse_[i] = nothing ? 0.0F : hit.reflectance * (1 - hit.metallic);
  retro_[i] = nothing ? 0.0F : hit.retro_reflection * static_cast<float>(retro_gain);
  models::LidarMath<float>::lidar_gloss(hit.reflectance, hit.metallic, hit.roughness, alpha2_[i], f0_[i]);
  if (nothing) f0_[i] = 0;
}

void Returns::see(const models::TofModel& model, const Eigen::Matrix3f& R_sensor_world,
                  const Eigen::Vector3f& eye, std::size_t first, Seen& seen) const {
  for (auto* v : {&seen.u_px, &seen.v_px, &seen.range_m, &seen.remission, &seen.off_axis_cos, &seen.rise})
    v->resize(count());
  const OpenCvLens& l = model.lens;
  const auto f = [](double v) { return static_cast<float>(v); };
  Camera c{.R = {},
           .eye = {},
           .fx = f(model.fx_px),
           .fy = f(model.fy_px),
           .cx = f(model.cx_px + 0.5),
           .cy = f(model.cy_px + 0.5),
           .k1 = f(l.k1),
           .k2 = f(l.k2),
           .p1 = f(l.p1),
           .p2 = f(l.p2),
           .k3 = f(l.k3),
           .k4 = f(l.k4),
           .k5 = f(l.k5),
           .k6 = f(l.k6)};
  for (int a = 0; a < 9; ++a) c.R[a] = R_sensor_world(a / 3, a % 3);
  for (int a = 0; a < 3; ++a) c.eye[a] = eye[a];
  const Points points{x_.data(),  y_.data(),       z_.data(),     met_.data(),    nx_.data(), ny_.data(),
                      nz_.data(), diffuse_.data(), retro_.data(), alpha2_.data(), f0_.data()};
  const Places to{seen.u_px.data(),      seen.v_px.data(),         seen.range_m.data(),
                  seen.remission.data(), seen.off_axis_cos.data(), seen.rise.data()};
  tbb::parallel_for(tbb::blocked_range<std::size_t>(first, count(), kGrain),
                    [&](const auto& range) { see_points(points, c, range.begin(), range.end(), to); });
}

}  // namespace rigor::tof
