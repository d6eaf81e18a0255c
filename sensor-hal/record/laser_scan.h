// A sweep of a 2D scanner as sensor_msgs/LaserScan: one range for each step of an even angle. Samples hold
// what came back; what did not is told by REP 117 (Informational Distance Measurements,
// ros.org/reps/rep-0117.html):
//   +inf  nothing came back within the scanner's reach (no point of that ray, or one beyond range_max)
//   -inf  something nearer than range_min
//   NaN   not measured: no point of that ray in a sample that is marked incomplete, or one that is no number
// The header's stamp is the sample's capture, which is the first ray's.
#pragma once

#include <cstdint>
#include <span>

#include "sensor-hal/record/ros2_messages.h"
#include "sensor-hal/types/sample.h"

namespace rigor::record {

/// Rays of a 2D scanner in its own frame (x forward, y left; angles anticlockwise from x), in the order of
/// firing.
struct ScanLine {
  double angle_min_rad = 0;        ///< of the first ray
  double angle_increment_rad = 0;  ///< from ray to ray; negative: it turns clockwise
  std::uint32_t rays = 0;
  double time_increment_s = 0;  ///< from ray to ray
  double scan_time_s = 0;       ///< from scan to scan
  double range_min_m = 0, range_max_m = 0;
  bool operator==(const ScanLine&) const = default;
};
inline constexpr std::uint32_t kMostRays = 1u << 17;

/// A device begins its scan where it begins, by a fraction of a step beside its sensor model: shifts
/// angle_min by what the points of a scan have in common, in hundredths of a step. Points that have nothing
/// in common, or are too few to tell (fewer than 8), shift nothing: false.
bool align(ScanLine& line, std::span<const LidarPoint> points);

/// Fills all but the header. Of several returns of a firing that of return_index 0 counts; points go to the
/// ray that is nearest, of several on one ray the nearest counts; those beyond the first and the last ray by
/// more than half a step are left out. Returns how many were. `incomplete`: the sample is marked kIncomplete.
/// Any thread; allocates until `out` has grown.
std::size_t fill_laser_scan(const ScanLine& line, std::span<const LidarPoint> points, bool incomplete,
                            msg::LaserScan& out);

}  // namespace rigor::record
