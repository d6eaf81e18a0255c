// What a camera's processor does to digital numbers: median, demosaicing, and the laying down of bits.
// Internal to the sensor stage. Planes lie row by row; `mosaic` planes begin at an even row and column of the
// sensor: red, green / green, blue.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "sensor-hal/types/pixel_format.h"

namespace rigor::sensor_stage {

struct NumberPlane {
  int width = 0, height = 0;
  std::vector<std::uint16_t> dn;
  void resize(int w, int h) {
    width = w;
    height = h;
    dn.resize(static_cast<std::size_t>(w) * static_cast<std::size_t>(h));
  }
  [[nodiscard]] std::uint16_t* row(int y) { return dn.data() + static_cast<std::size_t>(y) * width; }
  [[nodiscard]] const std::uint16_t* row(int y) const {
    return dn.data() + static_cast<std::size_t>(y) * width;
  }
};

/// Median of the 3x3 pixels at distance `step` (1; 2 on a mosaic, for the same colour). Beyond the border the
/// picture is mirrored about its outermost pixels.
void median_3x3(const NumberPlane& in, int step, NumberPlane& out);

/// Malvar, He and Cutler ("High-quality linear interpolation for demosaicing of Bayer-patterned color
/// images", ICASSP 2004). Mirrored beyond the border; clipped to [0, max_dn].
void demosaic(const NumberPlane& mosaic, std::uint16_t max_dn, std::array<NumberPlane, 3>& colours);

/// Mono12p from one number per pixel.
void pack_12p(std::span<const std::uint16_t> numbers, std::byte* out);

}  // namespace rigor::sensor_stage
