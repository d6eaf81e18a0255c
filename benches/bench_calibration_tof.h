// The time-of-flight rows of bench_calibration.
#pragma once

#include <nlohmann/json_fwd.hpp>

namespace rigor::bench {

/// A simulated camera of 176x144 px before a plane at ten distances, four pictures each: 1.01 million ranges.
/// Time of each step on the wall and of all on the processors, one model and all of them compared, and the
/// parameters' errors against the camera that made them. Prints a table, returns the same as JSON. Exits
/// where a step fails.
[[nodiscard]] nlohmann::json tof_rows();

}  // namespace rigor::bench
