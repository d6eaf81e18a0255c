// How a sensor moves that a body carries, and what gravity it feels.
#pragma once

#include <Eigen/Geometry>
#include <functional>
#include <optional>

#include "sensor-hal/channel/providers.h"

namespace rigor {

/// At one instant; the world's frame is local Cartesian, x east, y north, z up.
struct SensorKinematics {
  Eigen::Isometry3d T_world_sensor = Eigen::Isometry3d::Identity();
  Eigen::Vector3d velocity_mps = Eigen::Vector3d::Zero();       ///< of the sensor's origin, in the world
  Eigen::Vector3d acceleration_mps2 = Eigen::Vector3d::Zero();  ///< likewise, without gravity
  Eigen::Vector3d rate_radps = Eigen::Vector3d::Zero();         ///< against the world, in the sensor's axes
};

/// Of a sensor on a body, with what its lever arm r adds: v = v_b + ω×r, a = a_b + α×r + ω×(ω×r), everything
/// at t (turning by the body's turn acceleration between its t_ref and t). Any thread, no allocation.
[[nodiscard]] SensorKinematics carried_by(const BodyState& body, BenchTime t,
                                          const Eigen::Isometry3d& T_body_sensor);

/// From poses around t, h before and after it, for carriers that know no more: relative errors of (ωh)²/6 and
/// (ωh)²/12 in velocity and acceleration for what turns or swings at ω.
[[nodiscard]] SensorKinematics differentiated(const Eigen::Isometry3d& before, const Eigen::Isometry3d& at,
                                              const Eigen::Isometry3d& after, double h_s);

/// Where a request's sensor is and how it moves at t, near its t_capture.
using Carrier = std::function<SensorKinematics(const SampleProvider::Request&, BenchTime t)>;

/// Origin of the world's frame on WGS 84.
struct GeoOrigin {
  double latitude_deg = 0, longitude_deg = 0, height_m = 0;  ///< above the ellipsoid
};

/// Gravity (with what the Earth's turning adds) and the Earth's rate in the world's frame.
class Earth {
 public:
  /// Normal gravity of WGS 84 where the origin is known, weaker upwards and pointing to the middle of the
  /// Earth from beside the origin; elsewhere 9.80665 m/s² downwards, and no turning.
  explicit Earth(const std::optional<GeoOrigin>& origin);
  /// A given value downwards everywhere; turning as above.
  Earth(const std::optional<GeoOrigin>& origin, double gravity_mps2);
  [[nodiscard]] Eigen::Vector3d gravity_mps2(const Eigen::Vector3d& p_world) const;
  [[nodiscard]] const Eigen::Vector3d& rate_radps() const { return rate_radps_; }

 private:
  double at_origin_mps2_ = 9.80665, per_m_ = 0, radius_m_ = 0;  ///< radius 0: the same everywhere
  Eigen::Vector3d rate_radps_ = Eigen::Vector3d::Zero();
};

}  // namespace rigor
