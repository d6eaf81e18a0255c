// How far an application's estimate of its pose was from the truth, by the recording of a run.
//
// The truth is a channel of kind pose, or of kind registers with x_m, y_m and yaw_deg; the estimate is a sink
// that receives x [m], y [m] and, where there are any, yaw [rad], sigma_x, sigma_y [m] and state (0:
// searching). A command of a cycle is the estimate at the instant of that cycle.
#pragma once

#include <filesystem>
#include <nlohmann/json_fwd.hpp>
#include <string>
#include <vector>

#include "rt-core/result.h"

namespace rigor {

struct LocalizationQuestion {
  std::string truth;     ///< channel
  std::string estimate;  ///< sink
  double after_s = 1;    ///< from the start of the run: earlier estimates do not count
};

struct LocalizationError {
  struct At {
    double t_s = 0;                    ///< since the start of the run
    double x_m = 0, y_m = 0;           ///< the truth
    double along_m = 0, across_m = 0;  ///< estimate less truth, forward and to the left by the true yaw
    double yaw_rad = 0;                ///< NaN: not given
    double sigma_m = 0;                ///< √((σx² + σy²)/2) as claimed; NaN: not given
    [[nodiscard]] double distance_m() const;
  };
  std::vector<At> at;         ///< in order of time
  double way_m = 0;           ///< of the true path between the first and the last of them
  std::size_t searching = 0;  ///< sent while the application said that it does not know its pose
  std::size_t no_truth = 0;   ///< sent at instants more than 0.1 s from every true pose
  double median_m = 0, p95_m = 0, worst_m = 0;
  double median_yaw_rad = 0, p95_yaw_rad = 0;  ///< of its amount; NaN: not given
  double squared_over_variance = 0;  ///< mean of distance² over 2σ²: 1 where σ is right; NaN: not given
};

/// not_found, protocol; bad_input where the recording has no such channel or sink, with the names it has.
[[nodiscard]] Result<LocalizationError> localization_error(const std::filesystem::path& recording,
                                                           const LocalizationQuestion& question);

[[nodiscard]] nlohmann::json to_json(const LocalizationError& error);
/// One line for people.
[[nodiscard]] std::string to_text(const LocalizationError& error);

/// A stem on the drawing.
struct DrawnStem {
  double x_m = 0, y_m = 0, radius_m = 0;
};
/// HTML: the true path from above, coloured by the distance of the estimate, among `stems`; what was wrong
/// over time; a table.
[[nodiscard]] std::string localization_section(const LocalizationError& error,
                                               const std::vector<DrawnStem>& stems);

}  // namespace rigor
