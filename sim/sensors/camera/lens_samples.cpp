#include "sim/sensors/camera/lens_samples.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace rigor {
namespace {

/// Direction numbers of one dimension: degree, coefficients of its primitive polynomial, initial values.
std::array<std::uint32_t, 32> directions(int degree, std::uint32_t coefficients,
                                         std::array<std::uint32_t, 3> initial) {
  std::array<std::uint32_t, 32> v{};
  for (int i = 0; i < 32; ++i) {
    if (degree == 0) {
      v[static_cast<std::size_t>(i)] = 1U << (31 - i);
    } else if (i < degree) {
      v[static_cast<std::size_t>(i)] = initial[static_cast<std::size_t>(i)] << (31 - i);
    } else {
      std::uint32_t x = v[static_cast<std::size_t>(i - degree)];
      x ^= x >> degree;
      for (int k = 1; k < degree; ++k)
        if (((coefficients >> (degree - 1 - k)) & 1U) != 0U) x ^= v[static_cast<std::size_t>(i - k)];
      v[static_cast<std::size_t>(i)] = x;
    }
  }
  return v;
}

float unit(std::uint32_t x) { return static_cast<float>(x >> 8) * 0x1p-24F; }

}  // namespace

LensSamples::LensSamples(int per_pixel, std::uint64_t key)
    : key_{static_cast<std::uint32_t>(key), static_cast<std::uint32_t>(key >> 32)} {
  static const std::array<std::array<std::uint32_t, 32>, 5> table{
      directions(0, 0, {}), directions(1, 0, {1, 0, 0}), directions(2, 1, {1, 3, 0}),
      directions(3, 1, {1, 3, 1}), directions(3, 2, {1, 1, 1})};
  points_.resize(static_cast<std::size_t>(std::max(per_pixel, 1)));
  for (std::size_t i = 0; i < points_.size(); ++i)
    for (std::size_t d = 0; d < 5; ++d) {
      std::uint32_t x = 0;
      for (std::size_t bit = 0; bit < 32; ++bit)
        if (((i >> bit) & 1U) != 0U) x ^= table[d][bit];
      points_[i][d] = x;
    }
}

LensSample LensSamples::sample(int i, const Shift& shift, bool lens) const {
  const auto& p = points_[static_cast<std::size_t>(i)];
  LensSample s;
  // The first two dimensions are the best spread: the pixel's area has them.
  if (points_.size() > 1) {
    s.u = unit(p[0] ^ shift[0]) - 0.5F;
    s.v = unit(p[1] ^ shift[1]) - 0.5F;
  }
  s.time = unit(p[2] ^ shift[2]) - 0.5F;
  if (lens) to_disc(unit(p[3] ^ shift[3]), unit(p[4] ^ shift[4]), s.lens_x, s.lens_y);
  return s;
}

void to_disc(float x, float y, float& disc_x, float& disc_y) {
  const float a = 2 * x - 1, b = 2 * y - 1;
  constexpr float kQuarter = std::numbers::pi_v<float> / 4;
  if (a == 0 && b == 0) {
    disc_x = disc_y = 0;
    return;
  }
  const bool wide = std::abs(a) > std::abs(b);
  const float r = wide ? a : b;
  const float angle = wide ? kQuarter * (b / a) : 2 * kQuarter - kQuarter * (a / b);
  disc_x = r * std::cos(angle);
  disc_y = r * std::sin(angle);
}

}  // namespace rigor
