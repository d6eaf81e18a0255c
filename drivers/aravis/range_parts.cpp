#include "drivers/aravis/range_parts.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace rigor {
namespace {

std::uint32_t word(std::span<const std::byte> b, std::size_t i) noexcept {
  return std::to_integer<std::uint32_t>(b[2 * i]) | std::to_integer<std::uint32_t>(b[2 * i + 1]) << 8;
}

template <class F>
void each_of(std::span<const float> plane, std::uint32_t width_px, const gige::Region& r,
             gige::MutableBytes out, F&& counts) noexcept {
  std::size_t at = 0;
  for (std::uint32_t y = r.y_px; y < r.y_px + r.height_px; ++y)
    for (std::uint32_t x = r.x_px; x < r.x_px + r.width_px; ++x, at += 2) {
      const std::uint32_t n = counts(plane[std::size_t{y} * width_px + x]);
      out[at] = static_cast<std::uint8_t>(n);
      out[at + 1] = static_cast<std::uint8_t>(n >> 8);
    }
}

}  // namespace

void RangeScale::set_pinhole(const gige::Region& region, double focal_px, double u_px, double v_px) {
  ray.clear();
  ray.reserve(std::size_t{region.width_px} * region.height_px);
  for (std::uint32_t v = 0; v < region.height_px; ++v)
    for (std::uint32_t u = 0; u < region.width_px; ++u)
      ray.push_back(static_cast<float>(
          std::hypot(1.0, (region.x_px + u - u_px) / focal_px, (region.y_px + v - v_px) / focal_px)));
}

void counts_to_range(const RangeScale& s, std::span<const std::byte> counts, bool gaps,
                     std::span<float> range_m) noexcept {
  for (std::size_t i = 0; i < range_m.size(); ++i) {
    const auto n = word(counts, i);
    const bool none = (s.invalid && n == *s.invalid) || (gaps && n == 0);
    const double along = s.scale_m * n + s.offset_m;
    range_m[i] = none ? std::numeric_limits<float>::quiet_NaN()
                      : static_cast<float>(s.ray.empty() ? along : along * static_cast<double>(s.ray[i]));
  }
}

void counts_to_amplitude(const RangeScale& s, std::span<const std::byte> counts, std::size_t bytes,
                         std::span<float> amplitude) noexcept {
  for (std::size_t i = 0; i < amplitude.size(); ++i) {
    const auto n = bytes == 1 ? std::to_integer<std::uint32_t>(counts[i]) : word(counts, i);
    amplitude[i] = static_cast<float>(s.amplitude_scale * n);
  }
}

void range_to_counts(std::span<const float> range_m, std::uint32_t width_px, const gige::Region& region,
                     double scale_m, gige::MutableBytes out) noexcept {
  each_of(range_m, width_px, region, out, [scale_m](float r) -> std::uint32_t {
    const double n = std::round(static_cast<double>(r) / scale_m);
    return n >= 1 && n <= 65535 ? static_cast<std::uint32_t>(n) : 0;  // NaN is neither
  });
}

void amplitude_to_counts(std::span<const float> amplitude, std::uint32_t width_px, const gige::Region& region,
                         double scale, gige::MutableBytes out) noexcept {
  each_of(amplitude, width_px, region, out, [scale](float a) -> std::uint32_t {
    const double n = std::round(static_cast<double>(a) / scale);
    return n >= 1 ? static_cast<std::uint32_t>(std::min(n, 65535.0)) : 0;
  });
}

}  // namespace rigor
