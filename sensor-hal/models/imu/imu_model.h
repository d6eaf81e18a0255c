// Error model of an inertial measurement unit. For each of its two triads, x the truth in the sensor's axes,
// ΔT the temperature above 25 °C, f the specific force:
//
//   y = b + b_T·ΔT + (1 + S + M)·x + G·f + instability + random walk + white, cut at the range, rounded
//
// S scale errors on the diagonal, M misalignment beside it, G what acceleration does to the rate (gyroscope
// alone). Fixed errors are those of the sensor model plus draws of the sensor model's sigmas: each name of a
// channel and each seed is another device of the kind. Slow noise as in allan_terms.h; white noise has the
// density N up to the bandwidth, where there is one below half the rate, and falls off beyond it as behind a
// filter of first order.
#pragma once

#include <array>
#include <cstdint>
#include <string>

#include "rt-core/result.h"
#include "rt-core/time.h"
#include "sensor-hal/models/imu/allan_terms.h"
#include "sensor-hal/models/markov_path.h"
#include "sensor-hal/types/sample.h"

namespace rigor::models {

/// Units of x: m/s² or rad/s.
struct ImuTriad {
  std::array<double, 3> bias{};           ///< [x]
  std::array<double, 3> bias_per_k{};     ///< [x/K]
  std::array<double, 3> scale{};          ///< relative: y = (1 + scale)·x
  std::array<double, 6> misalignment{};   ///< M: xy, xz, yx, yz, zx, zy
  std::array<double, 9> g_sensitivity{};  ///< G, row by row [x per m/s²]
  double bias_sigma = 0, bias_per_k_sigma = 0, scale_sigma = 0, misalignment_sigma = 0;
  double g_sensitivity_sigma = 0;
  std::array<double, 3> white{};  ///< N of each axis [x·√s]
  double instability = 0;         ///< B [x]
  double instability_time_s = 100;
  double random_walk = 0;   ///< K [x/√s]
  double bandwidth_hz = 0;  ///< −3 dB; 0, or above half the rate: white up to there
  double range = 0;         ///< ±; 0: none
  double resolution = 0;    ///< one digit; 0: none
};
struct ImuModel {
  std::string name;
  ImuTriad accelerometer, gyroscope;
  double delay_s = 0;       ///< of the filters: a sample tells how it was that long before its capture
  bool earth_rate = false;  ///< the gyroscope feels the Earth turn, where the world says where it lies
  bool tells_temperature = false;
  double ambient_c = 25;                       ///< where it stands when it is switched on
  double warm_up_k = 0, warm_up_time_s = 300;  ///< warmer by warm_up·(1 − e^(−t/time))
  double temperature_resolution_k = 0;
};

/// bad_input, naming the field.
[[nodiscard]] Status check(const ImuModel& model);

/// Fixed part of the model of a triad, over any number type: y as above without noise, range and rounding.
template <class REAL>
std::array<REAL, 3> triad_response(const ImuTriad& t, const std::array<REAL, 3>& x,
                                   const std::array<REAL, 3>& specific_force_mps2, const REAL& above_25_k) {
  const auto& m = t.misalignment;
  const auto& g = t.g_sensitivity;
  const auto& f = specific_force_mps2;
  std::array<REAL, 3> y;
  for (std::size_t i = 0; i < 3; ++i)
    y[i] = REAL(t.bias[i]) + REAL(t.bias_per_k[i]) * above_25_k + REAL(1 + t.scale[i]) * x[i] +
           REAL(g[3 * i]) * f[0] + REAL(g[3 * i + 1]) * f[1] + REAL(g[3 * i + 2]) * f[2];
  y[0] += REAL(m[0]) * x[1] + REAL(m[1]) * x[2];
  y[1] += REAL(m[2]) * x[0] + REAL(m[3]) * x[2];
  y[2] += REAL(m[4]) * x[0] + REAL(m[5]) * x[1];
  return y;
}

/// The device of this model that a key draws: its sigmas become part of the fixed errors.
[[nodiscard]] ImuModel draw_device(ImuModel model, PhiloxKey key);

/// What one device makes of the truth. One thread at a time; no allocation. The same index gives the same
/// errors, whatever was asked before.
class ImuErrors {
 public:
  /// `period`: between captures, > 0.
  ImuErrors(const ImuModel& model, PhiloxKey key, Duration period);
  [[nodiscard]] const ImuModel& device() const noexcept { return device_; }
  /// °C, `since_start_s` after it was switched on.
  [[nodiscard]] double temperature_c(double since_start_s) const noexcept;
  [[nodiscard]] ImuSample measure(std::uint64_t index, double since_start_s,
                                  const std::array<double, 3>& specific_force_mps2,
                                  const std::array<double, 3>& angular_rate_radps) noexcept;

 private:
  struct Noise {
    MarkovPath white, instability, walk;
    bool white_is_path = false;
    std::array<double, 3> white_sigma{};
    double instability_sigma = 0, walk_sigma = 0;
  };
  [[nodiscard]] Noise noise_of(const ImuTriad& t, PhiloxKey key, std::uint32_t stream, double period_s) const;
  void add_noise(std::array<double, 3>& y, const ImuTriad& t, Noise& noise, std::uint64_t index,
                 std::uint32_t stream) const noexcept;

  ImuModel device_;
  PhiloxKey key_;
  Noise accelerometer_, gyroscope_;
};

}  // namespace rigor::models
