#include "sensor-hal/models/lidar/scan_grid.h"

#include <algorithm>
#include <cmath>

namespace rigor::models {

ScanGrid::ScanGrid(const LidarScan& scan)
    : scan_(scan), returns_(std::size_t{scan.columns} * scan.beams.size() * kReturns) {}

Result<ScanGrid> ScanGrid::create(const LidarScan& scan) {
  if (scan.kind != LidarScanKind::rotor)
    return fail(ErrorCode::bad_input, "scan.kind", "expected rotor, got a scan that has no columns");
  if (scan.columns == 0 || scan.beams.empty() || scan.beams.size() * scan.columns > kMaxLidarFirings ||
      (scan.columns > 1 && !(scan.column_period_s > 0)))
    return fail(ErrorCode::bad_input, "scan", "expected beams and columns that follow each other in time");
  return ScanGrid(scan);
}

Result<ScanGrid> ScanGrid::create_of_pattern(const LidarScan& scan) {
  if (scan.kind != LidarScanKind::pattern)
    return fail(ErrorCode::bad_input, "scan.kind", "expected pattern, got another kind of scan");
  const auto step_ns = static_cast<std::int64_t>(std::llround(scan.column_period_s * 1e9));
  const bool ends = scan.pattern.table && !scan.pattern.table->periodic;
  if (step_ns <= 0 || scan.pattern_scan_ns != step_ns * scan.columns || ends || scan.beams.empty() ||
      scan.columns * scan.beams.size() > kMaxLidarFirings)
    return fail(ErrorCode::bad_input, "scan.pattern",
                "expected a pattern without end whose firings are evenly apart, a whole number of them in a "
                "scan");
  ScanGrid grid(scan);
  grid.places_.resize(std::size_t{scan.columns} * scan.beams.size());
  return grid;
}

void ScanGrid::fill(std::span<const LidarPoint> points, double turn_rad) {
  std::fill(returns_.begin(), returns_.end(), Return{});
  strays_ = 0;
  for (const LidarPoint& p : points) {
    if (p.ring >= scan_.beams.size() || p.return_index >= kReturns) {
      ++strays_;
      continue;
    }
    const LidarBeam& beam = scan_.beams[p.ring];
    const double since_s = p.t_offset_ns * 1e-9 - beam.fire_time_s;
    const double column = scan_.column_period_s > 0 ? std::round(since_s / scan_.column_period_s) : 0;
    if (!(column >= 0 && column < scan_.columns) ||
        std::abs(since_s - column * scan_.column_period_s) > 0.25 * scan_.column_period_s) {
      ++strays_;
      continue;
    }
    const auto c = static_cast<std::uint32_t>(column);
    const std::size_t firing = std::size_t{c} * scan_.beams.size() + p.ring;
    Return& to = returns_[firing * kReturns + p.return_index];
    if (!places_.empty()) {
      to = {std::hypot(p.x_m, p.y_m, p.z_m), p.remission};
      if (p.return_index == 0) places_[firing] = {p.x_m, p.y_m, p.z_m};
      continue;
    }
    const LidarAim aim = rotor_aim(beam, azimuth_rad(c, p.ring) + turn_rad);
    const double range_m = (static_cast<double>(p.x_m) - aim.origin_m[0]) * aim.direction[0] +
                           (static_cast<double>(p.y_m) - aim.origin_m[1]) * aim.direction[1] +
                           (static_cast<double>(p.z_m) - aim.origin_m[2]) * aim.direction[2];
    to = {static_cast<float>(std::max(range_m, 0.0)), p.remission};
  }
}

}  // namespace rigor::models
