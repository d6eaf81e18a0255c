// Poses, inertial measurements, fixes and odometry as plain numbers with names: how a device tells of them by
// registers or signals of a bus, and how the bench takes them back.
//
//   kind       values (those in brackets may be missing)
//   pose       x_m, y_m [, z_m, roll_deg, pitch_deg, yaw_deg]
//   imu        force_x_mps2, force_y_mps2, force_z_mps2, rate_x_degps, rate_y_degps, rate_z_degps [,
//   temperature_c] nav_fix    latitude_deg, longitude_deg, height_m [, status, satellites,
//   sigma_horizontal_m, sigma_vertical_m] odometry   x_m, y_m, yaw_deg [, velocity_mps, turn_rate_degps,
//   left_angle, right_angle, left_rate, right_rate],
//              or left_angle, right_angle [, left_rate, right_rate] in rad and rad/s alone, with the wheels'
//              radius and the effective track: the pose is then added up here, from the first sample on
//
// `status` counts FixStatus: 0 none, 1 fix, 2 sbas, 3 rtk_float, 4 rtk_fixed; a place that is not finite is
// none.
#pragma once

#include <array>
#include <cstddef>
#include <span>
#include <string>
#include <vector>

#include "rt-core/result.h"
#include "sensor-hal/types/sample.h"

namespace rigor {

struct ValueName {
  const char *name, *unit;
};
/// All values of a kind, in the order of the table; empty for kinds that are not numbers alone.
[[nodiscard]] std::span<const ValueName> values_of_kind(SampleKind kind);
/// The values of a sample in that order; `out` has as many. NaN where the sample does not know. No
/// allocation.
void values_of_sample(const Sample& sample, std::span<double> out) noexcept;

/// Wheels of a vehicle whose odometry is its wheels' angles.
struct WheelGeometry {
  double wheel_radius_m = 0, track_m = 0;  ///< track: the effective one; 0: not told
};

/// From values with names to samples of a kind.
class TypedValues {
 public:
  /// `names`: what the device tells, in its order. bad_input, with what is missing, where they do not make
  /// such a sample. Setup context.
  [[nodiscard]] static Result<TypedValues> make(SampleKind kind, const std::vector<std::string>& names,
                                                const WheelGeometry& wheels);
  /// Odometry of angles begins anew.
  void reset() noexcept { seen_ = false; }
  /// The sample of these values, taken at `t`. False: one that is needed is not finite; `out` is then what
  /// could be said. Loop thread, no allocation.
  [[nodiscard]] bool convert(const RegisterBlock& block, BenchTime t, Sample& out) noexcept;

 private:
  [[nodiscard]] double value(const RegisterBlock& block, std::size_t i, double otherwise) const noexcept;
  [[nodiscard]] Odometry odometry(const RegisterBlock& block, BenchTime t, bool& known) noexcept;

  static constexpr std::size_t kMost = 9, kNone = ~std::size_t{0};
  SampleKind kind_ = SampleKind::none;
  std::array<std::size_t, kMost> at_{};  ///< where in the block; kNone: not told
  WheelGeometry wheels_;
  bool by_angles_ = false, seen_ = false;
  BenchTime t_;
  std::array<double, 2> angle_rad_{};
  double x_m_ = 0, y_m_ = 0, yaw_rad_ = 0;
};

}  // namespace rigor
