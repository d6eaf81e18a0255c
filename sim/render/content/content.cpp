#include "sim/render/content/content.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace rigor::render {

std::uint64_t next_serial() noexcept {
  static std::atomic<std::uint64_t> last{0};
  return last.fetch_add(1, std::memory_order_relaxed) + 1;
}

Spectrum SkyMap::at(const Eigen::Vector3d& direction) const {
  if (width < 1 || height < 1) return {};
  const double azimuth = std::atan2(direction.x(), direction.y());  // from north over east
  const double elevation = std::asin(std::clamp(direction.z() / direction.norm(), 0.0, 1.0));
  const double u = azimuth / (2 * std::numbers::pi) * width - 0.5;
  const double v = std::clamp(elevation / (std::numbers::pi / 2) * height - 0.5, 0.0, height - 1.0);
  const double u0 = std::floor(u), v0 = std::floor(v);
  const auto column = [&](double x) {
    const int i = static_cast<int>(x) % width;
    return i < 0 ? i + width : i;
  };
  const int i0 = column(u0), i1 = column(u0 + 1);
  const int j0 = static_cast<int>(v0), j1 = std::min(j0 + 1, height - 1);
  const auto fu = static_cast<float>(u - u0), fv = static_cast<float>(v - v0);
  Spectrum s{};
  for (std::size_t b = 0; b < s.size(); ++b) {
    const auto texel = [&](int i, int j) { return radiance[static_cast<std::size_t>(j * width + i)][b]; };
    const float low = texel(i0, j0) * (1 - fu) + texel(i1, j0) * fu;
    const float high = texel(i0, j1) * (1 - fu) + texel(i1, j1) * fu;
    s[b] = low * (1 - fv) + high * fv;
  }
  return s;
}

}  // namespace rigor::render
