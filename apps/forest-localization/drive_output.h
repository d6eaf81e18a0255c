// The sink that drives: speed with a turn rate, or speed with an angle of the front wheels. Keys:
// forest_localization.h, `drive`.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "apps/forest-localization/path_follower.h"
#include "sensor-hal/channel/application.h"

namespace rigor::forest {

class DriveOutput {
 public:
  /// Setup context. Throws ConfigError with its place.
  DriveOutput(const ConfigNode& n, const ApplicationPorts& ports, Period loop_period);
  /// As its keys have it.
  [[nodiscard]] const PathFollowerConfig& follower_config() const noexcept { return follower_config_; }

  // Loop thread; no allocation.
  [[nodiscard]] bool due(std::uint64_t cycle) const noexcept { return cycle % every_ == 0; }
  [[nodiscard]] double period_s() const noexcept { return period_s_; }
  void send(const DriveCommand& command, BenchTime now) noexcept;

 private:
  CommandPort* port_ = nullptr;
  std::size_t v_at_ = 0, w_at_ = 1, count_ = 2;
  std::array<double, 16> values_{};
  std::uint64_t every_ = 1;
  double period_s_ = 0;
  bool turns_by_angle_ = false;
  double wheelbase_m_ = 1, max_steer_rad_ = 0.5;
  PathFollowerConfig follower_config_;
};

}  // namespace rigor::forest
