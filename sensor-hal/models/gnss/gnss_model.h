// Error model of a satellite receiver, along east, north and up:
//
//   error = white + drift + multipath
//
// Drift (orbits, clocks, what of the air no model takes away) and multipath are Gauss–Markov processes of
// first order with times of their own. A receiver with corrections is rtk_fixed, and rtk_float for a while
// after it lost the count of waves: larger errors, drifting faster. Outages: no fix at all. Both come as a
// Poisson process of starts with exponential lengths. Under a canopy multipath is larger and events are more
// frequent: `canopy` is the share of the sky that it covers, 0 to 1, and scales both linearly up to what the
// sensor model says for 1.
#pragma once

#include <array>
#include <cstdint>
#include <string>

#include "rt-core/result.h"
#include "rt-core/time.h"
#include "sensor-hal/models/markov_path.h"
#include "sensor-hal/types/sample.h"

namespace rigor::models {

/// Standard deviations, horizontal of each axis.
struct GnssNoise {
  double white_horizontal_m = 0, white_vertical_m = 0;
  double drift_horizontal_m = 0, drift_vertical_m = 0;
  double drift_time_s = 600;
};
struct GnssEvents {
  double per_h = 0;    ///< starts, in the mean, under the open sky
  double mean_s = 10;  ///< length
};
struct GnssModel {
  std::string name;
  FixStatus status = FixStatus::fix;  ///< at its best: fix, sbas or rtk_fixed
  GnssNoise best;                     ///< in that status
  GnssNoise rtk_float;                ///< while an rtk_fixed receiver is not
  GnssEvents losses;                  ///< of the fixed solution
  GnssEvents outages;                 ///< of any
  double multipath_horizontal_m = 0, multipath_vertical_m = 0, multipath_time_s = 20;
  double canopy_multipath = 1;   ///< times as large under a closed canopy
  double canopy_events = 1;      ///< times as frequent
  double canopy_satellites = 0;  ///< fewer by so many
  double first_fix_s = 0;        ///< after the start
  double satellites = 12, satellites_sigma = 0, satellites_time_s = 60;
  double claimed_scale = 1;           ///< claimed over true standard deviation
  std::array<double, 3> antenna_m{};  ///< phase centre in the sensor's frame
  double delay_s = 0;                 ///< a fix tells where it was that long before its capture
};
/// bad_input, naming the field.
[[nodiscard]] Status check(const GnssModel& model);

struct GnssError {
  FixStatus status = FixStatus::none;
  std::uint16_t satellites = 0;
  std::array<double, 3> enu_m{};                ///< measured less true
  std::array<double, 3> claimed_sigma_enu_m{};  ///< as the receiver claims it
};

/// Whether one of a Poisson process of events is under way `t_s` after the start (≥ 0). `share`: of all
/// events those that count, 0 to 1. A pure function. Any thread.
[[nodiscard]] bool event_under_way(PhiloxKey key, NoiseEffect effect, const GnssEvents& events, double share,
                                   double t_s) noexcept;

/// One thread at a time; no allocation. The same request gives the same error, whatever was asked before.
class GnssErrors {
 public:
  /// `period`: between captures, > 0.
  GnssErrors(const GnssModel& model, PhiloxKey key, Duration period);
  [[nodiscard]] const GnssModel& model() const noexcept { return model_; }
  [[nodiscard]] GnssError at(std::uint64_t index, double since_start_s, double canopy) noexcept;

 private:
  GnssModel model_;
  PhiloxKey key_;
  MarkovPath drift_, float_drift_, multipath_, satellites_;
};

}  // namespace rigor::models
