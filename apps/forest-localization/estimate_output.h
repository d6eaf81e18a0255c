// The sink that is told what the application knows. Keys: forest_localization.h, `estimate`.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <limits>

#include "apps/forest-localization/statistics.h"
#include "sensor-hal/channel/application.h"

namespace rigor::forest {

struct Estimate {
  PoseGaussian pose;
  double lean_sigma_m = 0;  ///< of the scanner's place, by the error of the tilt: no scan tells
  double state = 0, stems = 0, matched = 0;
  double progress_m = 0, cross_track_m = 0;
  double target_range_m = std::numeric_limits<double>::quiet_NaN();
  double target_bearing_rad = std::numeric_limits<double>::quiet_NaN();
  bool done = false;
  double cut = 0, out_of_reach = 0;
};

class EstimateOutput {
 public:
  /// Setup context. Throws ConfigError with its place.
  EstimateOutput(const ConfigNode& n, const ApplicationPorts& ports, Period loop_period);

  // Loop thread; no allocation.
  [[nodiscard]] bool due(std::uint64_t cycle) const noexcept { return cycle % every_ == 0; }
  void send(const Estimate& e, BenchTime now) noexcept;

 private:
  CommandPort* port_ = nullptr;
  Eigen::Vector2d at_m_ = Eigen::Vector2d::Zero();  ///< the point of the base that is asked for
  std::array<std::size_t, 16> index_{};             ///< which of the names each value of the sink is
  std::size_t count_ = 0;
  std::uint64_t every_ = 1;
};

}  // namespace rigor::forest
