// The LiDAR rows of bench_calibration.
#pragma once

#include <nlohmann/json_fwd.hpp>

namespace rigor::bench {

/// A simulated scanner of 16 beams in a room of four walls, 70 scans: 1.01 million returns. Time on the wall
/// and on the processors of the whole fit, one model and all of them compared, and the parameters' errors
/// against the scanner that made them. Prints a table, returns the same as JSON. Exits where a fit fails.
[[nodiscard]] nlohmann::json lidar_rows();

}  // namespace rigor::bench
