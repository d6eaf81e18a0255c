// What a beam should measure of a plane, and how that changes with every parameter.
//
//   measured = scale·r + bias_b + walk·(1 − E) + oblique·(1 − cos θ),      r = (1 − q·o)/(q·u)
//
// u(elevation + δe_b, azimuth + δa_b) is the beam's direction, o its origin (models::rotor_aim), q the plane
// (plane_search.h), E the remission (at most 1), θ the angle of incidence. Derivatives are analytic.
#pragma once

#include <Eigen/Core>
#include <array>

#include "calibration/lidar/plane_search.h"

namespace rigor::calibration {

/// Errors of the ranges of one beam on one plane.
struct BeamErrors {
  double bias_m = 0, elevation_rad = 0,
         azimuth_rad = 0;  ///< elevation and azimuth: to be added to the sensor model's
  double remission_bias_m = 0, incidence_bias_m = 0, scale = 1;
};

struct PredictedRange {
  double range_m = 0;
  double cos_incidence = 0;
  double d_elevation_m = 0, d_azimuth_m = 0;  ///< per radian
  double d_walk = 0, d_oblique = 0, d_scale_m = 0;
  Eigen::Vector3d d_q_m2{0, 0, 0};
};

/// `beam` is the sensor model's; `remission` is E. Any thread.
[[nodiscard]] PredictedRange predict_range(const models::LidarBeam& beam, const BeamErrors& errors,
                                           double azimuth_rad, double remission,
                                           const Eigen::Vector3d& q_per_m);

}  // namespace rigor::calibration
