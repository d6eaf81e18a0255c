// Measures a simulated channel by every engine and quality that come into question, against `rays` in full
// with many samples, and takes the cheapest that is good enough.
//
// Errors are of the light alone: sensors measure without noise for them. Times are those of the whole sensor.
#pragma once

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "bench/sensing/simulation.h"
#include "bench/sensing/tolerance.h"

namespace rigor {

struct Trial {
  EngineChoice choice;
  double p50_ms = 0, max_ms = 0;  ///< median and slowest of `timed` captures
  int timed = 0;
  double range_rmse_m = 0, outliers = 0, radiance = 0;  ///< as Tolerance has them
  bool meets = false;
};

struct TunedChannel {
  std::string channel;
  Tolerance tolerance;
  std::vector<Trial> trials;
  std::optional<std::size_t> best_index;  ///< of `trials`; empty: none meets the tolerance

  [[nodiscard]] const Trial* best() const { return best_index ? &trials[*best_index] : nullptr; }
};

/// How far two scans are apart: points of one firing, offset, ring and return, by their range.
struct RangeError {
  double rmse_m = 0;    ///< of those that are no outliers
  double outliers = 0;  ///< share of all: off by more than `limit_m`, missed, false
};
[[nodiscard]] RangeError difference_of(std::span<const LidarPoint> reference,
                                       std::span<const LidarPoint> points, double limit_m);
/// Pixel by pixel; NaN is no return.
[[nodiscard]] RangeError difference_of(std::span<const float> reference_m, std::span<const float> range_m,
                                       double limit_m);

/// `progress` is told what is being measured. Errors: bad_input (the channel's keys), unavailable.
[[nodiscard]] Result<TunedChannel> tune_channel(Simulation& simulation, const RigConfig& rig,
                                                const ChannelEntry& entry, const Tolerance& tolerance,
                                                const std::function<void(const std::string&)>& progress);

/// The keys of a channel's simulated side; null where it has none.
[[nodiscard]] const ConfigNode* simulated_params(const ChannelEntry& entry);

}  // namespace rigor
