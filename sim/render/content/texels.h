// Texels of maps in linear light, one by one and at coarser levels of detail.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <memory>
#include <vector>

#include "sim/render/content/content.h"

namespace rigor::render {

/// Linear light to the nearest byte of sRGB (IEC 61966-2-1).
class SrgbBytes {
 public:
  SrgbBytes();
  [[nodiscard]] std::uint8_t of(float linear) const noexcept {
    const float v = linear > 0 ? std::min(linear, 1.0F) : 0.0F;
    const unsigned byte = step_[static_cast<std::size_t>(v * static_cast<float>(kSteps))];
    return static_cast<std::uint8_t>(byte + (v >= least_[byte + 1] ? 1U : 0U));
  }

 private:
  static constexpr int kSteps = 4096;
  std::array<float, 257> least_{};  ///< linear light of each byte; of 256: beyond all
  std::array<std::uint8_t, kSteps + 1>
      step_{};  ///< light from a step to the next has this byte or the one after
};
[[nodiscard]] const SrgbBytes& srgb_bytes() noexcept;
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
