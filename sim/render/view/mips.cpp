#include <algorithm>
#include <array>
#include <cmath>

#include "sim/render/view/texture_pool.h"

namespace rigor::render {
namespace {

float linear_from_srgb(float v) { return v <= 0.04045F ? v / 12.92F : std::pow((v + 0.055F) / 1.055F, 2.4F); }
float srgb_from_linear(float v) {
  return v <= 0.0031308F ? v * 12.92F : 1.055F * std::pow(v, 1.0F / 2.4F) - 0.055F;
}

struct Level {
  int width = 1, height = 1;
  std::vector<float> rgba;  ///< colour in linear light
};

/// Halves both sides; an odd last row or column is spread over its neighbours.
Level half(const Level& a, bool weigh) {
  Level b;
  b.width = std::max(a.width / 2, 1);
  b.height = std::max(a.height / 2, 1);
  b.rgba.resize(static_cast<std::size_t>(b.width) * b.height * 4);
  for (int y = 0; y < b.height; ++y)
    for (int x = 0; x < b.width; ++x) {
      const int x0 = x * a.width / b.width, x1 = (x + 1) * a.width / b.width;
      const int y0 = y * a.height / b.height, y1 = (y + 1) * a.height / b.height;
      float sum[4] = {}, plain[3] = {}, weight = 0;
      int n = 0;
      for (int j = y0; j < std::max(y1, y0 + 1); ++j)
        for (int i = x0; i < std::max(x1, x0 + 1); ++i) {
          const float* p = &a.rgba[(static_cast<std::size_t>(j) * a.width + i) * 4];
          const float w = weigh ? p[3] : 1.0F;
          for (int c = 0; c < 3; ++c) {
            sum[c] += w * p[c];
            plain[c] += p[c];
          }
          sum[3] += p[3];
          weight += w;
          ++n;
        }
      float* q = &b.rgba[(static_cast<std::size_t>(y) * b.width + x) * 4];
      for (int c = 0; c < 3; ++c) q[c] = weight > 1e-6F ? sum[c] / weight : plain[c] / static_cast<float>(n);
      q[3] = sum[3] / static_cast<float>(n);
    }
  return b;
}

double coverage(const Level& l, float cutoff, float scale) {
  std::size_t n = 0;
  for (std::size_t i = 3; i < l.rgba.size(); i += 4) n += l.rgba[i] * scale >= cutoff ? 1 : 0;
  return static_cast<double>(n) / (static_cast<double>(l.rgba.size()) / 4);
}

/// The factor of alpha under which a level covers as much as `wanted`.
float alpha_scale(const Level& l, float cutoff, double wanted) {
  float low = 0.0F, high = 8.0F;
  for (int i = 0; i < 16; ++i) {
    const float middle = 0.5F * (low + high);
    (coverage(l, cutoff, middle) < wanted ? low : high) = middle;
  }
  return high;
}

std::vector<std::byte> encode(const Level& l, bool srgb, float scale) {
  std::vector<std::byte> out(l.rgba.size());
  for (std::size_t i = 0; i < l.rgba.size(); ++i) {
    const bool alpha = i % 4 == 3;
    float v = alpha ? l.rgba[i] * scale : l.rgba[i];
    if (srgb && !alpha) v = srgb_from_linear(v);
    out[i] = static_cast<std::byte>(std::lround(std::clamp(v, 0.0F, 1.0F) * 255.0F));
  }
  return out;
}

}  // namespace

std::vector<ImageUploads::Level> make_mips(const Texture& t, float cutoff) {
  std::array<float, 256> linear{};
  for (std::size_t i = 0; i < 256; ++i) {
    const float v = static_cast<float>(i) / 255.0F;
    linear[i] = t.srgb ? linear_from_srgb(v) : v;
  }
  Level now;
  now.width = static_cast<int>(t.width);
  now.height = static_cast<int>(t.height);
  now.rgba.resize(static_cast<std::size_t>(t.width) * t.height * 4);
  for (std::size_t i = 0; i < now.rgba.size(); ++i)
    now.rgba[i] = i % 4 == 3 ? static_cast<float>(t.rgba[i]) / 255.0F : linear[t.rgba[i]];
  const double wanted = cutoff > 0 ? coverage(now, cutoff, 1.0F) : 1.0;
  std::vector<ImageUploads::Level> all;
  ImageUploads::Level first{t.width, t.height, {}};
  first.bytes.resize(now.rgba.size());
  std::transform(t.rgba.begin(), t.rgba.begin() + static_cast<std::ptrdiff_t>(now.rgba.size()),
                 first.bytes.begin(), [](std::uint8_t v) { return std::byte{v}; });
  all.push_back(std::move(first));
  while (now.width > 1 || now.height > 1) {
    now = half(now, cutoff > 0);
    const float scale = cutoff > 0 ? alpha_scale(now, cutoff, wanted) : 1.0F;
    all.push_back({static_cast<std::uint32_t>(now.width), static_cast<std::uint32_t>(now.height),
                   encode(now, t.srgb, scale)});
  }
  return all;
}

}  // namespace rigor::render
