// Way and turn of the base by its wheels, from whatever tells of them: odometry; the angles of both sides'
// wheels; or the angles of a wheel and of the steering. Keys: forest_localization.h, `odometry`.
#pragma once

#include <array>
#include <cstddef>

#include "sensor-hal/channel/application.h"

namespace rigor::forest {

class OdometryInput {
 public:
  /// Setup context. Throws ConfigError with its place.
  OdometryInput(const ConfigNode& n, const ApplicationPorts& ports);

  // Loop thread; no allocation.
  /// Takes up what came in this cycle; false: nothing did.
  bool take() noexcept;
  /// Of the last that was taken: its instant, and the sums from the first one on.
  [[nodiscard]] BenchTime t() const noexcept { return t_; }
  [[nodiscard]] double way_m() const noexcept { return way_m_; }
  [[nodiscard]] double turn_rad() const noexcept { return turn_rad_; }

 private:
  void find_registers(const ConfigNode& n, const ChannelDescription& description);
  void add(const Odometry& o, BenchTime t) noexcept;
  void add_sides(double left_rad, double right_rad) noexcept;
  void add_steered(double wheel_rad, double steer_rad) noexcept;

  const SamplePort* port_ = nullptr;
  std::array<std::size_t, 2> register_{};
  double wheel_radius_m_ = 0, track_m_ = 1, wheelbase_m_ = 1;
  bool steered_ = false;  ///< by an angle of the front wheels
  std::array<double, 3>
      previous_{};  ///< x, y, yaw; or the angles of the wheels; or of a wheel and of steering
  double way_m_ = 0, turn_rad_ = 0;
  BenchTime t_;
  bool seen_ = false;
};

}  // namespace rigor::forest
