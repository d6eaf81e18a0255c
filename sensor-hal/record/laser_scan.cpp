#include "sensor-hal/record/laser_scan.h"

#include <cmath>
#include <limits>
#include <numbers>

namespace rigor::record {

bool align(ScanLine& line, std::span<const LidarPoint> points) {
  constexpr std::size_t kEnough = 8;
  constexpr double kTurn = 2 * std::numbers::pi, kInCommon = 0.9;
  if (line.angle_increment_rad == 0) return false;
  // Fractions of a step as angles of a full turn: their mean is that of the shift, their resultant says how
  // much they agree.
  double sine = 0, cosine = 0;
  std::size_t count = 0;
  for (const LidarPoint& p : points) {
    const double steps = (std::atan2(p.y_m, p.x_m) - line.angle_min_rad) / line.angle_increment_rad;
    if (!std::isfinite(steps)) continue;
    sine += std::sin(kTurn * steps);
    cosine += std::cos(kTurn * steps);
    ++count;
  }
  if (count < kEnough || std::hypot(sine, cosine) < kInCommon * static_cast<double>(count)) return false;
  // In hundredths: the same whichever scan is the first, in a replay, too.
  const double steps = std::round(100 * std::atan2(sine, cosine) / kTurn) / 100;
  line.angle_min_rad += steps * line.angle_increment_rad;
  return true;
}

std::size_t fill_laser_scan(const ScanLine& line, std::span<const LidarPoint> points, bool incomplete,
                            msg::LaserScan& out) {
  constexpr float kInfinity = std::numeric_limits<float>::infinity();
  constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();
  constexpr double kTurn = 2 * std::numbers::pi;
  const double step = line.angle_increment_rad;
  out.angle_min = static_cast<float>(line.angle_min_rad);
  out.angle_increment = static_cast<float>(step);
  out.angle_max = static_cast<float>(line.angle_min_rad + step * (line.rays > 0 ? line.rays - 1 : 0));
  out.time_increment = static_cast<float>(line.time_increment_s);
  out.scan_time = static_cast<float>(line.scan_time_s);
  out.range_min = static_cast<float>(line.range_min_m);
  out.range_max = static_cast<float>(line.range_max_m);
  out.ranges.assign(line.rays, incomplete ? kNaN : kInfinity);
  out.intensities.assign(line.rays, 0);
  if (line.rays == 0 || step == 0) return points.size();
  std::size_t strays = 0;
  for (const LidarPoint& p : points) {
    if (p.return_index != 0) continue;
    // Counted in steps from the first ray on, in the sense of the rotation, within half a step before it.
    double steps = (std::atan2(p.y_m, p.x_m) - line.angle_min_rad) / step;
    const double turn = kTurn / std::abs(step);
    steps -= turn * std::floor((steps + 0.5) / turn);
    const double ray = std::floor(steps + 0.5);
    if (!(ray >= 0 && ray < line.rays)) {
      ++strays;
      continue;
    }
    const auto i = static_cast<std::size_t>(ray);
    const double range_m = std::hypot(p.x_m, p.y_m, p.z_m);
    const float told = !std::isfinite(range_m)      ? kNaN
                       : range_m < line.range_min_m ? -kInfinity
                       : range_m > line.range_max_m ? kInfinity
                                                    : static_cast<float>(range_m);
    if (out.ranges[i] <= told) continue;
    out.ranges[i] = told;
    out.intensities[i] = p.remission;
  }
  return strays;
}

}  // namespace rigor::record
