// Roll and pitch of a vehicle from an inertial unit and the speed of its wheels: the gyroscope for what is
// quick, gravity for what lasts. One Kalman filter for each axis, with the angle and the gyroscope's bias.
//
// A scanner h above the ground stands h·sin(pitch) ahead of where a level one would: 40 mm at 0.6 m on a
// slope of 4 degrees. What stays wrong is the accelerometer's bias (20 mg: 20 mrad).
#pragma once

#include <array>

#include "apps/forest-localization/stem_detector.h"
#include "apps/forest-localization/timeline.h"
#include "rt-core/time.h"

namespace rigor::forest {

/// R_world_base = Rz(yaw)·Ry(pitch)·Rx(roll): pitch is positive where the nose is down.
struct Tilt {
  double roll_rad = 0, pitch_rad = 0;
};

/// A stem seen `height_m` above the vehicle's origin, in its tilted frame, as a level vehicle would see it.
[[nodiscard]] StemObservation levelled(const StemObservation& in_base, double height_m,
                                       const Tilt& tilt) noexcept;

/// Loop thread, no allocation; setup constructs.
class TiltFilter {
 public:
  struct Config {
    double gravity_mps2 = 9.81;
    double start_sigma_rad = 0.2, bias_sigma_radps = 0.02;
    double rate_noise_rad2_per_s = 4e-6;   ///< of the gyroscope: noise, and its scale in a curve
    double gravity_noise_rad2_s = 2.7e-4;  ///< bumps: 0.03 rad that last for 0.3 s
  };
  TiltFilter() = default;
  explicit TiltFilter(const Config& config) : config_(config) {}

  /// Of the wheels: way since some start. What they accelerate is not gravity.
  void odometry(BenchTime t, double way_m) noexcept;
  /// In the base's axes; later than all before, else left out.
  void imu(BenchTime t, const std::array<double, 3>& specific_force_mps2,
           const std::array<double, 3>& rate_radps) noexcept;
  /// Level before the first sample.
  [[nodiscard]] Tilt at(BenchTime t) const noexcept;

 private:
  struct Axis {
    double angle_rad = 0, bias_radps = 0;
    double p_angle = 0, p_cross = 0, p_bias = 0;
    void predict(double rate_radps, double dt_s, double noise) noexcept;
    void update(double angle_rad, double variance) noexcept;
  };

  Config config_;
  Axis roll_, pitch_;
  bool begun_ = false;
  BenchTime t_imu_;
  Timeline<2> angles_;  ///< roll, pitch
  Timeline<1> way_;
  double speed_mps_ = 0, acceleration_mps2_ = 0;
  BenchTime t_speed_;
};

}  // namespace rigor::forest
