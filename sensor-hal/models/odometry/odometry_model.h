// Error model of the odometry of a vehicle with a left and a right side (two driven wheels, or skid
// steering): encoders that count ticks, and a computer that believes in radii and a track of its own.
//
//   angle   = ⌊ticks·φ/2π + phase⌋·2π/ticks           φ: the wheel's true angle
//   rate    = (angle(t) − angle(t − period))/period
//   forward = (r_l·rate_l + r_r·rate_r)/2,  turn = (r_r·rate_r − r_l·rate_l)/track
//
// with r and track as believed: those of the sensor model times 1 + error. Slip is no matter of the sensor:
// the wheels turn, the vehicle does not follow. With skid steering `track_m` is the effective one, which is
// wider than the vehicle.
#pragma once

#include <array>
#include <cstdint>
#include <string>

#include "rt-core/result.h"
#include "rt-core/time.h"
#include "sensor-hal/models/philox.h"
#include "sensor-hal/types/sample.h"

namespace rigor::models {

struct OdometryModel {
  std::string name;
  double wheel_radius_m = 0.2, track_m = 1;  ///< as the computer has them before errors
  std::array<double, 2> radius_error{};      ///< left, right; relative
  double track_error = 0;                    ///< relative
  double radius_error_sigma = 0, track_error_sigma = 0;
  double ticks_per_turn = 0;  ///< 0: no rounding
  // Claimed standard deviations.
  double position_per_m = 0;                  ///< of the way, along and across alike
  double yaw_rad_per_m = 0, yaw_per_rad = 0;  ///< of the way; of the angle that was turned
  double speed_mps = 0, turn_rate_radps = 0;
};
/// bad_input, naming the field.
[[nodiscard]] Status check(const OdometryModel& model);

/// Where a vehicle comes to that goes `way` metres on a circle while it turns by `turn` radians, in its frame
/// before: over any number type.
template <class REAL>
std::array<REAL, 2> along_circle(const REAL& way_m, const REAL& turn_rad) {
  using std::cos;
  using std::sin;
  const REAL half = turn_rad / REAL(2);
  // sin(x)/x by its series where the quotient loses digits.
  const REAL chord =
      way_m * (half < REAL(1e-4) && half > REAL(-1e-4) ? REAL(1) - half * half / REAL(6) : sin(half) / half);
  return {chord * cos(half), chord * sin(half)};
}

/// One device, from its first capture on. Angles, rates and twist depend on the request alone; the pose is
/// what all captures since the start add up to, as in every odometry. Captures come in rising order; the last
/// one may be asked for again; an earlier one starts anew. One thread at a time; no allocation.
class OdometryDevice {
 public:
  /// `period`: between captures, > 0.
  OdometryDevice(const OdometryModel& model, PhiloxKey key, Duration period);
  [[nodiscard]] const OdometryModel& model() const noexcept { return model_; }
  struct Wheels {
    std::array<double, 2> angle_rad{}, rate_radps{};  ///< true; left, right; forward counts up
  };
  [[nodiscard]] Odometry measure(std::uint64_t index, BenchTime t_start, const Wheels& wheels) noexcept;

 private:
  [[nodiscard]] double counted(std::size_t side, double angle_rad) const noexcept;

  OdometryModel model_;
  double period_s_;
  std::array<double, 2> radius_m_{}, phase_{};
  double track_m_ = 1;

  bool any_ = false;
  std::uint64_t last_index_ = 0;
  BenchTime t_start_;
  double x_m_ = 0, y_m_ = 0, yaw_rad_ = 0;
  double way_m_ = 0, turned_rad_ = 0;  ///< sums of absolute values
  Odometry last_;
};

}  // namespace rigor::models
