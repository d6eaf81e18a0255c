#include "sim/render/content/texels.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>

namespace rigor::render {
namespace {

// IEC 61966-2-1; 0 to 1.
float linear_from_srgb(float v) noexcept {
  return v <= 0.04045F ? v / 12.92F : std::pow((v + 0.055F) / 1.055F, 2.4F);
}

float srgb_from_linear(float v) noexcept {
  return v <= 0.0031308F ? v * 12.92F : 1.055F * std::pow(v, 1.0F / 2.4F) - 0.055F;
}

std::uint8_t nearest_byte(float v) noexcept {
  return static_cast<std::uint8_t>(static_cast<double>(std::clamp(v, 0.0F, 1.0F) * 255.0F) + 0.5);
}

}  // namespace

SrgbBytes::SrgbBytes() {
  const auto byte_of = [](float linear) {
    return static_cast<int>(std::lround(255 * srgb_from_linear(linear)));
  };
  for (int byte = 1; byte < 256; ++byte) {
    // By their bits, numbers from 0 on are in order.
    std::uint32_t below = 0, least = std::bit_cast<std::uint32_t>(1.0F);
    while (least - below > 1) {
      const std::uint32_t middle = below + (least - below) / 2;
      (byte_of(std::bit_cast<float>(middle)) < byte ? below : least) = middle;
    }
    least_[static_cast<std::size_t>(byte)] = std::bit_cast<float>(least);
  }
  least_[256] = 2;
  for (std::size_t i = 0; i < step_.size(); ++i)
    step_[i] = static_cast<std::uint8_t>(byte_of(static_cast<float>(i) / static_cast<float>(kSteps)));
}

const SrgbBytes& srgb_bytes() noexcept {
  static const SrgbBytes bytes;
  return bytes;
}

const float* linear_of_bytes(bool srgb) noexcept {
  static const auto tables = [] {
    std::array<std::array<float, 256>, 2> t{};
    for (std::size_t i = 0; i < 256; ++i) {
      t[0][i] = static_cast<float>(i) / 255.0F;
      t[1][i] = linear_from_srgb(t[0][i]);
    }
    return t;
  }();
  return tables[srgb ? 1 : 0].data();
}

const Texture* usable(const std::shared_ptr<const Texture>& t) noexcept {
  const bool there = t && t->width > 0 && t->height > 0 && t->width <= 32768 && t->height <= 32768 &&
                     t->rgba.size() >= static_cast<std::size_t>(t->width) * t->height * 4;
  return there ? t.get() : nullptr;
}

ColourToBand colour_to_band(const std::array<int, 4>& bands, bool mean_for_near_infrared) noexcept {
  ColourToBand m{};
  for (std::size_t channel = 0; channel < 4; ++channel)
    for (std::size_t colour = 0; colour < 3; ++colour)
      m[colour][channel] = bands[channel] < 3 ? (bands[channel] == static_cast<int>(colour) ? 1.0F : 0.0F)
                                              : (mean_for_near_infrared ? 1.0F / 3.0F : 0.0F);
  return m;
}

ColourToBand near_infrared_to_band(const std::array<int, 4>& bands) noexcept {
  std::array<int, 4> shifted{};
  for (std::size_t i = 0; i < 4; ++i) shifted[i] = bands[i] >= 3 ? bands[i] - 3 : 3;
  return colour_to_band(shifted, false);
}

LinearTexels linear_texels(const Texture& t) {
  const float *const colour = linear_of_bytes(t.srgb), *const plain = linear_of_bytes(false);
  LinearTexels out{t.width, t.height, {}};
  out.texels.resize(static_cast<std::size_t>(t.width) * t.height);
  for (std::size_t i = 0; i < out.texels.size(); ++i) {
    const std::uint8_t* const p = &t.rgba[4 * i];
    out.texels[i] = LinearTexels::Texel{colour[p[0]], colour[p[1]], colour[p[2]], plain[p[3]]};
  }
  return out;
}

LinearTexels halved(const LinearTexels& a, bool weigh) {
  LinearTexels b{std::max(a.width / 2, 1U), std::max(a.height / 2, 1U), {}};
  b.texels.resize(static_cast<std::size_t>(b.width) * b.height);
  const auto begin = [](std::uint32_t i, std::uint32_t from, std::uint32_t to) {
    return from == 2 * to ? 2 * i : static_cast<std::uint32_t>(std::uint64_t{i} * from / to);
  };
  for (std::uint32_t y = 0; y < b.height; ++y)
    for (std::uint32_t x = 0; x < b.width; ++x) {
      LinearTexels::Texel sum{}, plain{};
      float weight = 0, n = 0;
      for (std::uint32_t j = begin(y, a.height, b.height); j < begin(y + 1, a.height, b.height); ++j)
        for (std::uint32_t i = begin(x, a.width, b.width); i < begin(x + 1, a.width, b.width); ++i) {
          const LinearTexels::Texel p = a.texels[std::size_t{j} * a.width + i];
          const float w = weigh ? p[3] : 1.0F;
          sum += p * w;
          plain += p;
          weight += w;
          n += 1;
        }
      LinearTexels::Texel q = weight > 1e-6F ? sum / weight : plain / n;
      q[3] = plain[3] / n;
      b.texels[std::size_t{y} * b.width + x] = q;
    }
  return b;
}

std::vector<std::uint8_t> bytes_of(const LinearTexels& level, bool srgb, float coverage_scale) {
  std::vector<std::uint8_t> out(4 * level.texels.size());
  std::uint8_t* to = out.data();
  const SrgbBytes& bytes = srgb_bytes();
  for (const LinearTexels::Texel& t : level.texels) {
    for (int c = 0; c < 3; ++c) *to++ = srgb ? bytes.of(t[c]) : nearest_byte(t[c]);
    *to++ = nearest_byte(t[3] * coverage_scale);
  }
  return out;
}

}  // namespace rigor::render
