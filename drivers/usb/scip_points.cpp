#include "drivers/usb/scip_points.h"

#include <algorithm>
#include <cmath>

namespace rigor::usb {

std::size_t scan_points(const ScipScan& scan, const ScannerParameters& p,
                        std::span<LidarPoint> points) noexcept {
  const ScanRequest& r = scan.request;
  const double step_ns = p.step_s() * 1e9;
  std::size_t count = 0;
  for (std::size_t i = 0; i < scan.range_mm.size() && count < points.size(); ++i) {
    const std::uint32_t mm = scan.range_mm[i];
    if (mm < p.min_range_mm || mm > p.max_range_mm || mm == 0) continue;
    const auto from = static_cast<std::uint32_t>(r.first_step + i * r.width());
    const std::uint32_t to = std::min(from + r.width() - 1, r.last_step);
    const double step = 0.5 * (from + to);
    const double angle = p.angle_rad(step), range_m = mm * 1e-3;
    points[count++] = {.x_m = static_cast<float>(range_m * std::cos(angle)),
                       .y_m = static_cast<float>(range_m * std::sin(angle)),
                       .z_m = 0,
                       .remission = i < scan.intensity.size() ? static_cast<float>(scan.intensity[i]) : 0.0F,
                       .t_offset_ns = static_cast<std::int32_t>(std::lround((step - p.first_step) * step_ns)),
                       .ring = 0,
                       .return_index = 0,
                       .flags = 0};
  }
  return count;
}

void measure_points(std::span<const LidarPoint> points, const ScannerModel& model,
                    std::span<std::uint32_t> range_mm, std::span<std::uint32_t> intensity) noexcept {
  const ScannerParameters& p = model.parameters;
  for (std::uint32_t s = 0; s < range_mm.size(); ++s)
    range_mm[s] = s < p.first_step || s > p.last_step ? model.unmeasured_code : model.no_return_code;
  std::fill(intensity.begin(), intensity.end(), 0);
  for (const LidarPoint& point : points) {
    const double azimuth = std::atan2(static_cast<double>(point.y_m), static_cast<double>(point.x_m));
    const double range_m =
        std::sqrt(static_cast<double>(point.x_m) * point.x_m + static_cast<double>(point.y_m) * point.y_m +
                  static_cast<double>(point.z_m) * point.z_m);
    const double at = p.front_step + azimuth * p.steps_per_turn / 6.283185307179586;
    if (!(range_m * 1e3 >= p.min_range_mm - 0.5) || !(range_m * 1e3 <= p.max_range_mm + 0.5) ||
        !std::isfinite(at))
      continue;
    auto step = std::llround(at);
    if (step < p.first_step) step += p.steps_per_turn;  // behind: the seam of atan2
    if (step > p.last_step) step -= p.steps_per_turn;
    if (step < p.first_step || step > p.last_step || step >= static_cast<long long>(range_mm.size()))
      continue;
    const auto s = static_cast<std::size_t>(step);
    const auto mm = static_cast<std::uint32_t>(
        std::clamp<long long>(std::llround(range_m * 1e3), p.min_range_mm, p.max_range_mm));
    if (range_mm[s] >= p.min_range_mm && range_mm[s] <= mm) continue;
    range_mm[s] = mm;
    intensity[s] =
        point.remission > 0
            ? static_cast<std::uint32_t>(std::min(std::lround(static_cast<double>(point.remission)), 262143L))
            : 0;
  }
}

}  // namespace rigor::usb
