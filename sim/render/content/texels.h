// Texels of maps in linear light, one by one and at coarser levels of detail.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <vector>

#include "sim/render/content/content.h"

namespace rigor::render {

/// Linear light to a byte of sRGB (IEC 61966-2-1).
[[nodiscard]] std::uint8_t srgb_byte(float linear) noexcept;
/// Of each of 256 bytes: in linear light, or as it is; 0 to 1.
[[nodiscard]] const float* linear_of_bytes(bool srgb) noexcept;

/// A map that has texels, at most 32768 along a side; null otherwise.
[[nodiscard]] const Texture* usable(const std::shared_ptr<const Texture>& map) noexcept;

/// How red, green and blue of a map multiply four bands (index of world::kBandWavelength_nm). Visible: its
/// own colour, and nothing else. Near infrared: their mean, or nothing where a near-infrared map gives it.
using ColourToBand = std::array<std::array<float, 4>, 3>;
[[nodiscard]] ColourToBand colour_to_band(const std::array<int, 4>& bands,
                                          bool mean_for_near_infrared) noexcept;
/// As above, of a near-infrared map.
[[nodiscard]] ColourToBand near_infrared_to_band(const std::array<int, 4>& bands) noexcept;

/// A level of detail: red, green, blue in linear light and coverage, row by row.
struct LinearTexels {
  using Texel = float __attribute__((vector_size(16)));
  std::uint32_t width = 1, height = 1;
  std::vector<Texel> texels;
};
/// Of a usable map.
[[nodiscard]] LinearTexels linear_texels(const Texture& map);
/// Of half the sides: means of the texels that lie in each, by coverage where it counts. An odd last row or
/// column is spread over its neighbours.
[[nodiscard]] LinearTexels halved(const LinearTexels& finer, bool weigh_by_coverage);
/// Bytes of texels, coverage times `coverage_scale`.
[[nodiscard]] std::vector<std::uint8_t> bytes_of(const LinearTexels& level, bool srgb,
                                                 float coverage_scale = 1);

}  // namespace rigor::render
