#include "calibration/lidar/range_equation.h"

#include <algorithm>
#include <cmath>

#include "sensor-hal/models/lidar/lidar_math.h"

namespace rigor::calibration {

PredictedRange predict_range(const models::LidarBeam& b, const BeamErrors& e, double azimuth_rad,
                             double remission, const Eigen::Vector3d& q) {
  using Eigen::Vector3d;
  const double a = azimuth_rad + b.azimuth_rad + e.azimuth_rad, el = b.elevation_rad + e.elevation_rad;
  const double ca = std::cos(a), sa = std::sin(a), ce = std::cos(el), se = std::sin(el);
  const Vector3d u(ce * ca, ce * sa, se);
  const Vector3d o(b.radial_offset_m * ca - b.horizontal_offset_m * sa,
                   b.radial_offset_m * sa + b.horizontal_offset_m * ca, b.vertical_offset_m);
  const Vector3d u_e(-se * ca, -se * sa, ce), u_a(-ce * sa, ce * ca, 0);
  const Vector3d o_a(-o.y(), o.x(), 0);
  const double across = q.dot(u), length = q.norm();
  const double r = (1 - q.dot(o)) / across;
  PredictedRange p;
  p.cos_incidence = std::abs(across) / length;
  const double sign = across < 0 ? -1 : 1;
  remission = std::max(remission, 0.0);
  p.d_walk = 1 - std::min(remission, 1.0);
  p.d_oblique = 1 - p.cos_incidence;
  p.d_scale_m = r;
  p.range_m =
      r + models::LidarMath<double>::lidar_range_error_m(r, e.scale, e.bias_m, e.remission_bias_m, remission,
                                                         e.incidence_bias_m, p.cos_incidence);
  const auto d_cos = [&](const Vector3d& d_u) { return sign * q.dot(d_u) / length; };
  p.d_elevation_m = -e.scale * r * q.dot(u_e) / across - e.incidence_bias_m * d_cos(u_e);
  p.d_azimuth_m = -e.scale * (q.dot(o_a) + r * q.dot(u_a)) / across - e.incidence_bias_m * d_cos(u_a);
  p.d_q_m2 = -e.scale * (o + r * u) / across -
             e.incidence_bias_m * (sign * u / length - p.cos_incidence * q / (length * length));
  return p;
}

}  // namespace rigor::calibration
