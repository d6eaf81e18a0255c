// Points spread evenly over a pixel's area, the lens' opening and the exposure: Sobol' points in five
// dimensions (Joe and Kuo 2008), scrambled for each pixel by a random digit shift, so that any power of two
// of them is stratified in each dimension. A function of key and pixel alone. Internal to sim/sensors/camera.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

namespace rigor {

/// Scrambles all bits (Murmur3's finaliser).
[[nodiscard]] constexpr std::uint32_t scramble(std::uint32_t x) {
  x = (x ^ (x >> 16)) * 0x85EBCA6BU;
  x = (x ^ (x >> 13)) * 0xC2B2AE35U;
  return x ^ (x >> 16);
}

struct LensSample {
  float u = 0, v = 0;            ///< within the pixel, −½ to ½
  float lens_x = 0, lens_y = 0;  ///< in the unit disc
  float time = 0;                ///< of the exposure, −½ to ½
};

class LensSamples {
 public:
  LensSamples(int per_pixel, std::uint64_t key);
  [[nodiscard]] int per_pixel() const { return static_cast<int>(points_.size()); }

  /// The digit shifts of one pixel of the full sensor.
  using Shift = std::array<std::uint32_t, 5>;
  [[nodiscard]] Shift shift_of(std::uint32_t pixel) const {
    Shift s{};
    const std::uint32_t h = scramble(pixel * 0x9E3779B9U + key_[0]) ^ key_[1];
    for (std::uint32_t d = 0; d < 5; ++d) s[d] = scramble(h + d * 0x632BE5ABU);
    return s;
  }
  /// One sample alone is the pixel's centre, at a random place of lens and exposure. `lens`: else that place
  /// is its middle.
  [[nodiscard]] LensSample sample(int i, const Shift& shift, bool lens = true) const;

 private:
  std::array<std::uint32_t, 2> key_;
  std::vector<std::array<std::uint32_t, 5>> points_;
};

/// The disc, area for area (Shirley and Chiu 1997). x, y in [0, 1).
void to_disc(float x, float y, float& disc_x, float& disc_y);

}  // namespace rigor
