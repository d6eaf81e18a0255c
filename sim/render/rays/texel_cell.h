// Which texels a place on a map lies between. Internal to sim/render/rays.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>

namespace rigor::render {

/// Plain x86-64 has no instruction for it. |t| below 2^31; else t itself.
inline float floor_of(float t) noexcept {
  if (!(t > -2e9F && t < 2e9F)) return t;
  const auto whole = static_cast<float>(static_cast<std::int32_t>(t));
  return whole > t ? whole - 1 : whole;
}

/// Along one axis: the two texels about a coordinate (0 to 1 over the map), and the share of the second.
struct TexelPair {
  std::uint32_t low = 0, high = 0;
  float share = 0;
};
inline TexelPair texels_about(float t, std::uint32_t size, bool repeat) noexcept {
  const auto n = static_cast<float>(size);
  TexelPair p;
  if (repeat) {
    t -= floor_of(t);
    if (!(t >= 0.0F && t < 1.0F)) t = 0.0F;  // not finite, or rounded up
    const float x = t * n - 0.5F;
    const float base = floor_of(x);
    p.share = x - base;
    const auto i = static_cast<std::int32_t>(base);
    p.low = i < 0 ? size - 1 : static_cast<std::uint32_t>(i);
    if (p.low >= size) p.low = size - 1;
    p.high = p.low + 1 == size ? 0 : p.low + 1;
    return p;
  }
  if (!(t > 0.0F)) t = 0.0F;
  if (t > 1.0F) t = 1.0F;
  const float x = t * n - 0.5F;
  const float base = floor_of(x);
  p.share = x - base;
  const auto i = static_cast<std::int32_t>(base);
  p.low = i < 0 ? 0 : static_cast<std::uint32_t>(i);
  p.high = std::min(static_cast<std::uint32_t>(i + 1), size - 1);
  return p;
}

/// Four texels of a map, row by row, and their shares.
struct TexelCell {
  std::size_t at[4];
  float share[4];
};
inline TexelCell cell_of(std::uint32_t width, const TexelPair& x, const TexelPair& y) noexcept {
  const std::size_t r0 = static_cast<std::size_t>(y.low) * width,
                    r1 = static_cast<std::size_t>(y.high) * width;
  return {
      {r0 + x.low, r0 + x.high, r1 + x.low, r1 + x.high},
      {(1 - x.share) * (1 - y.share), x.share * (1 - y.share), (1 - x.share) * y.share, x.share * y.share}};
}

}  // namespace rigor::render
