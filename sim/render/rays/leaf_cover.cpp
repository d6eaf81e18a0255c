#include "sim/render/rays/leaf_cover.h"

#include <algorithm>
#include <bit>
#include <cmath>

#include "sim/render/rays/texel_cell.h"

namespace rigor::render {
namespace {

/// Sides of the coarsest level are no shorter: pictures of twigs that share a map, some four along a side,
/// would mix in coarser ones.
constexpr std::uint32_t kFewestTexels = 32;

/// What texel i covers of a row of `size` that is scaled by `each`: texels and their shares, of odd sizes up
/// to three.
template <class F>
void for_covered(std::uint32_t i, float each, std::uint32_t size, F&& f) {
  const float from = static_cast<float>(i) * each, to = from + each;
  for (auto k = static_cast<std::uint32_t>(from); k < size && static_cast<float>(k) < to; ++k)
    f(k, (std::min(static_cast<float>(k) + 1, to) - std::max(static_cast<float>(k), from)) / each);
}

std::vector<float> halved(const std::vector<float>& in, std::uint32_t width, std::uint32_t height) {
  const std::uint32_t half_width = (width + 1) / 2, half_height = (height + 1) / 2;
  std::vector<float> out;
  out.reserve(static_cast<std::size_t>(half_width) * half_height);
  if (width % 2 == 0 && height % 2 == 0) {
    for (std::uint32_t y = 0; y < half_height; ++y) {
      const float *const upper = &in[std::size_t{2} * y * width], *const lower = upper + width;
      for (std::uint32_t x = 0; x < width; x += 2)
        out.push_back(0.25F * upper[x] + 0.25F * upper[x + 1] + 0.25F * lower[x] + 0.25F * lower[x + 1]);
    }
    return out;
  }
  const float each_x = static_cast<float>(width) / static_cast<float>(half_width),
              each_y = static_cast<float>(height) / static_cast<float>(half_height);
  for (std::uint32_t y = 0; y < half_height; ++y)
    for (std::uint32_t x = 0; x < half_width; ++x) {
      float sum = 0;
      for_covered(y, each_y, height, [&](std::uint32_t row, float of_rows) {
        for_covered(x, each_x, width, [&](std::uint32_t column, float of_columns) {
          sum += of_rows * of_columns * in[static_cast<std::size_t>(row) * width + column];
        });
      });
      out.push_back(sum);
    }
  return out;
}

/// Byte of a place in tiles of 16 x 16.
inline std::size_t byte_of(std::uint32_t tiles_across, std::uint32_t x, std::uint32_t y) noexcept {
  return 64 * (static_cast<std::size_t>(y / 16) * tiles_across + x / 16) + 4 * (y % 16) + x % 16 / 4;
}

}  // namespace

LeafCover::LeafCover(const Texture& map, float alpha_cutoff)
    : width_(map.width),
      height_(map.height),
      repeat_(map.repeat),
      cutoff_(alpha_cutoff * 255.0F),
      coverage_(static_cast<std::size_t>(map.width) * map.height),
      tiles_across_((map.width + 15) / 16) {
  for (std::size_t i = 0; i < coverage_.size(); ++i) coverage_[i] = map.rgba[4 * i + 3];
  note_what_lies_between();
  make_levels();
}

void LeafCover::note_what_lies_between() {
  // Wider than what a weighted mean of bytes may be rounded by.
  constexpr float kRounded = 0.01F;
  const std::size_t w = width_, h = height_;
  between_.assign(std::size_t{64} * tiles_across_ * ((height_ + 15) / 16), 0);
  for (std::uint32_t y = 0; y < height_; ++y)
    for (std::uint32_t x = 0; x < width_; ++x) {
      const std::size_t x1 = x + 1 < w ? x + 1 : 0, y1 = y + 1 < h ? y + 1 : 0;
      const auto [least, most] = std::minmax(
          {coverage_[y * w + x], coverage_[y * w + x1], coverage_[y1 * w + x], coverage_[y1 * w + x1]});
      const unsigned all = static_cast<float>(most) < cutoff_ - kRounded    ? hole
                           : static_cast<float>(least) > cutoff_ + kRounded ? leaf
                                                                            : some;
      std::uint8_t& four = between_[byte_of(tiles_across_, x, y)];
      four = static_cast<std::uint8_t>(four | all << (2 * (x & 3U)));
    }
}

void LeafCover::make_levels() {
  std::uint32_t width = width_, height = height_;
  if (std::min(width, height) < 2 * kFewestTexels) return;
  // What hole_at() says at four places of each texel: it thresholds what is interpolated. Each of them lies
  // in another of the four cells that meet there.
  std::vector<float> share(coverage_.size());
  for (std::uint32_t y = 0; y < height; ++y)
    for (std::uint32_t x = 0; x < width; ++x) {
      const bool inside = x > 0 && y > 0 && x + 1 < width && y + 1 < height;
      float leaf_share = 0;
      for (std::uint32_t down = 0; down < 2; ++down)
        for (std::uint32_t right = 0; right < 2; ++right) {
          const Between all = inside ? between(x - 1 + right, y - 1 + down) : some;
          const auto place = [](std::uint32_t texel, std::uint32_t half, std::uint32_t size) {
            return (static_cast<float>(texel) + (half == 0 ? 0.25F : 0.75F)) / static_cast<float>(size);
          };
          if (all == some ? !hole_at(place(x, right, width), place(y, down, height)) : all == leaf)
            leaf_share += 0.25F;
        }
      share[static_cast<std::size_t>(y) * width + x] = leaf_share;
    }
  while (std::min(width, height) >= 2 * kFewestTexels) {
    share = halved(share, width, height);
    width = (width + 1) / 2;
    height = (height + 1) / 2;
    Level level{width, height, std::vector<std::uint8_t>(share.size())};
    std::transform(share.begin(), share.end(), level.leaf.begin(),
                   [](float s) { return static_cast<std::uint8_t>(255 * s + 0.5F); });
    levels_.push_back(std::move(level));
  }
}

LeafCover::Between LeafCover::between(std::uint32_t x, std::uint32_t y) const noexcept {
  return static_cast<Between>(between_[byte_of(tiles_across_, x, y)] >> (2 * (x & 3U)) & 3U);
}

bool LeafCover::hole_at(float u, float v) const noexcept {
  const TexelPair x = texels_about(u, width_, repeat_), y = texels_about(v, height_, repeat_);
  // Most places are well within a leaf or well beside it. (A clamped cell at the edge is part of the one that
  // begins at its first texel.)
  const Between all = between(x.low, y.low);
  if (all != some) return all == hole;
  const TexelCell c = cell_of(width_, x, y);
  float sum = 0;
  for (std::size_t i = 0; i < 4; ++i) sum += c.share[i] * static_cast<float>(coverage_[c.at[i]]);
  return sum < cutoff_;
}

std::uint8_t LeafCover::leaf_at(float u, float v, float side_texels) const noexcept {
  // The nearest level by log2 of the side: its exponent, counted from the square root of a half on.
  const float side = std::clamp(side_texels * 1.41421356F, 1.0F, 65536.0F);
  const auto level = (std::bit_cast<std::uint32_t>(side) >> 23U) - 127U;
  if (level == 0 || levels_.empty()) return hole_at(u, v) ? 0 : 255;
  const Level& l = levels_[std::min<std::size_t>(level, levels_.size()) - 1];
  const TexelCell c = cell_of(l.width, texels_about(u, l.width, repeat_), texels_about(v, l.height, repeat_));
  float sum = 0.5F;
  for (std::size_t i = 0; i < 4; ++i) sum += c.share[i] * static_cast<float>(l.leaf[c.at[i]]);
  return static_cast<std::uint8_t>(std::min(sum, 255.0F));
}

}  // namespace rigor::render
