#include <algorithm>
#include <span>

#include "sim/render/content/texels.h"
#include "sim/render/view/texture_pool.h"

namespace rigor::render {
namespace {

double coverage(const LinearTexels& l, float cutoff, float scale) {
  const auto n = std::count_if(l.texels.begin(), l.texels.end(),
                               [&](const LinearTexels::Texel& t) { return t[3] * scale >= cutoff; });
  return static_cast<double>(n) / static_cast<double>(l.texels.size());
}

/// The factor of alpha under which a level covers as much as `wanted`.
float alpha_scale(const LinearTexels& l, float cutoff, double wanted) {
  float low = 0.0F, high = 8.0F;
  for (int i = 0; i < 16; ++i) {
    const float middle = 0.5F * (low + high);
    (coverage(l, cutoff, middle) < wanted ? low : high) = middle;
  }
  return high;
}

}  // namespace

std::vector<ImageUploads::Level> make_mips(const Texture& t, float cutoff) {
  std::vector<ImageUploads::Level> all;
  const auto add = [&](const LinearTexels& l, std::span<const std::uint8_t> bytes) {
    const auto of = std::as_bytes(bytes);
    all.push_back({l.width, l.height, {of.begin(), of.end()}});
  };
  LinearTexels now = linear_texels(t);
  add(now, std::span(t.rgba).first(4 * now.texels.size()));
  const double wanted = cutoff > 0 ? coverage(now, cutoff, 1.0F) : 1.0;
  while (now.width > 1 || now.height > 1) {
    now = halved(now, cutoff > 0);
    add(now, bytes_of(now, t.srgb, cutoff > 0 ? alpha_scale(now, cutoff, wanted) : 1.0F));
  }
  return all;
}

}  // namespace rigor::render
