// Which parts of a picture samples stand for, and what lies in each pixel. Internal to sim/sensors/tof.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

namespace rigor::tof {

/// A square of the picture, from its upper left corner.
struct PicturePart {
  float left_px = 0, top_px = 0, side_px = 0;

  /// f(pixel, area in pixels) of the pixels that it covers.
  template <class F>
  void each_pixel(int width_px, int height_px, const F& f) const {
    const float right_px = left_px + side_px, bottom_px = top_px + side_px;
    if (!(right_px > 0 && bottom_px > 0 && left_px < static_cast<float>(width_px) &&
          top_px < static_cast<float>(height_px)))
      return;
    const int u0 = std::max(static_cast<int>(left_px), 0), v0 = std::max(static_cast<int>(top_px), 0);
    for (int v = v0; v < height_px && static_cast<float>(v) < bottom_px; ++v) {
      const float down =
          std::min(bottom_px, static_cast<float>(v + 1)) - std::max(top_px, static_cast<float>(v));
      for (int u = u0; u < width_px && static_cast<float>(u) < right_px; ++u)
        f(static_cast<std::size_t>(v * width_px + u),
          down * (std::min(right_px, static_cast<float>(u + 1)) - std::max(left_px, static_cast<float>(u))));
    }
  }
};

/// What lies in each pixel.
class PixelParts {
 public:
  struct Part {
    std::uint32_t sample;
    float area_px;
  };

  void clear(std::size_t pixels) {
    first_.assign(pixels, kNone);
    cover_.assign(pixels, 0);
    nodes_.clear();
  }
  [[nodiscard]] bool empty() const { return first_.empty(); }
  void add(std::size_t pixel, std::uint32_t sample, float area_px) {
    nodes_.push_back({{sample, area_px}, first_[pixel]});
    first_[pixel] = static_cast<std::uint32_t>(nodes_.size() - 1);
    cover_[pixel] += area_px;
  }
  void clear_pixel(std::size_t pixel) {
    first_[pixel] = kNone;
    cover_[pixel] = 0;
  }
  /// Sum of the areas of what lies in a pixel: 1 where nothing overlaps and nothing lacks.
  [[nodiscard]] float cover(std::size_t pixel) const { return cover_[pixel]; }
  /// Latest first.
  template <class F>
  void each_part(std::size_t pixel, const F& f) const {
    for (std::uint32_t n = first_[pixel]; n != kNone; n = nodes_[n].next) f(nodes_[n].part);
  }

 private:
  static constexpr std::uint32_t kNone = 0xFFFFFFFF;
  struct Node {
    Part part;
    std::uint32_t next;
  };
  std::vector<Node> nodes_;
  std::vector<std::uint32_t> first_;
  std::vector<float> cover_;
};

}  // namespace rigor::tof
