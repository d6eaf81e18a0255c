// Value noise by counter: the same number at the same place of the world, whatever was asked before, at any
// distance from the origin. Octave k has a wavelength of 2^k metres, on a lattice anchored at the world's
// origin.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "sensor-hal/models/philox.h"

namespace rigor::nature {

/// Of all places of a use.
[[nodiscard]] inline models::PhiloxKey place_key(std::uint64_t seed, std::uint32_t stream) {
  return {static_cast<std::uint32_t>(seed), static_cast<std::uint32_t>(seed >> 32) ^ stream * 0x9E3779B9U};
}
/// What the upper halves of a place's numbers make of its counter.
[[nodiscard]] inline std::uint32_t place_high_word(std::int64_t x, std::int64_t y) {
  return static_cast<std::uint32_t>(static_cast<std::uint64_t>(x >> 32) * 0x85EBCA6BU ^
                                    static_cast<std::uint64_t>(y >> 32) * 0xC2B2AE35U);
}
/// Four random words for one place. `stream` tells uses apart, x and y are lattice or cell numbers.
[[nodiscard]] inline std::array<std::uint32_t, 4> place_words(std::uint64_t seed, std::uint32_t stream,
                                                              std::int64_t x, std::int64_t y,
                                                              std::uint32_t index = 0) {
  return models::philox(
      {static_cast<std::uint32_t>(x), static_cast<std::uint32_t>(y), index, place_high_word(x, y) ^ stream},
      place_key(seed, stream));
}
/// 0 ≤ u < 1.
[[nodiscard]] inline double unit_from_word(std::uint32_t w) { return w * 0x1p-32; }

struct FractalNoise {
  std::uint32_t stream = 0;
  int longest = 4;    ///< wavelength of the slowest octave is 2^longest m
  int shortest = -5;  ///< and of the fastest 2^shortest m
  double gain = 0.6;  ///< amplitude of an octave against the next slower one

  /// Standard deviation of the sum at(…), all octaves.
  [[nodiscard]] double sigma() const;
};

/// The sum of the octaves at one place: mean 0.
[[nodiscard]] double noise_at(const FractalNoise& noise, double x, double y);

/// The sum at the n × n places x0 + i·step, y0 − j·step (rows from the north), octaves shorter than two steps
/// left out. `missing_sigma` is the standard deviation of what was left out.
struct NoiseRaster {
  std::vector<float> values;
  double missing_sigma = 0;
};
struct RasterPlaces {
  double x0 = 0, y0 = 0, step = 1;
  int n = 1;
};
[[nodiscard]] NoiseRaster noise_over(const FractalNoise& noise, const RasterPlaces& places);

}  // namespace rigor::nature
