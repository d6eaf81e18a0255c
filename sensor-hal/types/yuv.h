// Colour as video devices carry it: 8-bit YCbCr, matrix of ITU-R BT.601, limited range (Y 16…235, Cb and Cr
// 16…240), which is what V4L2 means by V4L2_YCBCR_ENC_601 with its default range and what UVC cameras say
// with matrix coefficients 4 (SMPTE 170M).
//
//   Y  = 16 + (66 R + 129 G + 25 B) / 256        R = 1.164 (Y − 16) + 1.596 (Cr − 128)
//   Cb = 128 + (−38 R − 74 G + 112 B) / 256      G = 1.164 (Y − 16) − 0.392 (Cb − 128) − 0.813 (Cr − 128)
//   Cr = 128 + (112 R − 94 G − 18 B) / 256       B = 1.164 (Y − 16) + 2.017 (Cb − 128)
//
// in integers, rounded to nearest (https://learn.microsoft.com/windows/win32/medfound/recommended-8-bit-yuv-
// formats-for-video-rendering). Chroma of several pixels is that of their mean colour. There and back differs
// by at most 3 where the colour of those pixels is one.
//
// Any thread; no allocation; spans have image_bytes of their format; width is even, for 4:2:0 height too.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <span>

namespace rigor::yuv {

[[nodiscard]] constexpr std::uint8_t luma(int r, int g, int b) {
  return static_cast<std::uint8_t>(16 + ((66 * r + 129 * g + 25 * b + 128) >> 8));
}
[[nodiscard]] constexpr std::uint8_t cb(int r, int g, int b) {
  return static_cast<std::uint8_t>(128 + ((-38 * r - 74 * g + 112 * b + 128) >> 8));
}
[[nodiscard]] constexpr std::uint8_t cr(int r, int g, int b) {
  return static_cast<std::uint8_t>(128 + ((112 * r - 94 * g - 18 * b + 128) >> 8));
}
[[nodiscard]] constexpr std::array<std::uint8_t, 3> rgb(int y, int u, int v) {
  const int c = 298 * (y - 16) + 128, d = u - 128, e = v - 128;
  const auto clip = [](int x) { return static_cast<std::uint8_t>(std::clamp(x >> 8, 0, 255)); };
  return {clip(c + 409 * e), clip(c - 100 * d - 208 * e), clip(c + 516 * d)};
}

inline void yuv422_from_rgb8(std::span<const std::byte> from, std::span<std::byte> to) noexcept {
  const auto* p = reinterpret_cast<const std::uint8_t*>(from.data());
  auto* q = reinterpret_cast<std::uint8_t*>(to.data());
  for (std::size_t left = std::min(from.size() / 6, to.size() / 4); left != 0; --left, p += 6, q += 4) {
    const int r = (p[0] + p[3] + 1) / 2, g = (p[1] + p[4] + 1) / 2, b = (p[2] + p[5] + 1) / 2;
    q[0] = luma(p[0], p[1], p[2]), q[1] = cb(r, g, b);
    q[2] = luma(p[3], p[4], p[5]), q[3] = cr(r, g, b);
  }
}

inline void yuv420_from_rgb8(std::span<const std::byte> from, std::size_t width_px, std::size_t height_px,
                             std::span<std::byte> to) noexcept {
  const auto* p = reinterpret_cast<const std::uint8_t*>(from.data());
  auto* y = reinterpret_cast<std::uint8_t*>(to.data());
  auto* uv = y + width_px * height_px;
  for (std::size_t i = 0; i < width_px * height_px; ++i) y[i] = luma(p[3 * i], p[3 * i + 1], p[3 * i + 2]);
  for (std::size_t row = 0; row + 1 < height_px; row += 2)
    for (std::size_t column = 0; column + 1 < width_px; column += 2, uv += 2) {
      const std::uint8_t* a = p + 3 * (row * width_px + column);
      const std::uint8_t* b = a + 3 * width_px;
      std::array<int, 3> mean{};
      for (std::size_t k = 0; k < 3; ++k) mean[k] = (a[k] + a[k + 3] + b[k] + b[k + 3] + 2) / 4;
      uv[0] = cb(mean[0], mean[1], mean[2]);
      uv[1] = cr(mean[0], mean[1], mean[2]);
    }
}

}  // namespace rigor::yuv
