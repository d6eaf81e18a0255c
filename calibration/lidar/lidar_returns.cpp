#include "calibration/lidar/lidar_returns.h"

#include <cmath>
#include <cstring>
#include <numbers>

namespace rigor::calibration {
namespace {

std::uint64_t hash_of(std::span<const LidarPoint> points) {
  std::uint64_t h = 1469598103934665603ULL;
  for (const LidarPoint& p : points) {
    std::uint32_t words[4];
    std::memcpy(&words[0], &p.x_m, 4);
    std::memcpy(&words[1], &p.y_m, 4);
    std::memcpy(&words[2], &p.z_m, 4);
    std::memcpy(&words[3], &p.remission, 4);
    for (const std::uint32_t w : words) h = (h ^ w) * 1099511628211ULL;
  }
  return h;
}

}  // namespace

void ReturnCollector::add(std::span<const LidarPoint> points) {
  if (points.empty()) return;
  if (!seen_.insert(hash_of(points)).second) {
    ++out_.duplicate_scans;
    return;
  }
  for (const LidarPoint& p : points) {
    if (p.return_index != 0) {
      ++out_.second_returns;
      continue;
    }
    if (p.ring >= beams_.size()) {
      ++out_.unknown_beams;
      continue;
    }
    // The beam starts `radial` ahead of and `horizontal` beside the rotor's axis (models::rotor_aim).
    const models::LidarBeam& b = beams_[p.ring];
    const double x = p.x_m, y = p.y_m, level2 = x * x + y * y;
    const double along =
        std::sqrt(std::max(0.0, level2 - b.horizontal_offset_m * b.horizontal_offset_m)) - b.radial_offset_m;
    const double up = p.z_m - b.vertical_offset_m;
    const double turn = std::atan2(y, x) - std::atan2(b.horizontal_offset_m, along + b.radial_offset_m);
    LidarReturn r;
    r.range_m = static_cast<float>(std::hypot(along, up));
    if (!(r.range_m > 0) || !std::isfinite(r.range_m)) continue;
    r.remission = p.remission;
    r.azimuth_rad = static_cast<float>(std::remainder(turn - b.azimuth_rad, 2 * std::numbers::pi));
    r.beam = p.ring;
    r.scan = out_.scans;
    out_.all.push_back(r);
  }
  ++out_.scans;
}

double remission_from_units(const models::LidarRemission& r, double units, double range_m) {
  if (r.range_exponent > 0) units *= std::pow(range_m / r.reference_range_m, r.range_exponent);
  if (units <= r.scale || !(r.retro_scale > 0)) return units / r.scale;
  return 1 + (units - r.scale) / r.retro_scale;
}

}  // namespace rigor::calibration
