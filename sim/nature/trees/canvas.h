// A picture in linear colour to draw twigs and leaves on.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <vector>

#include "sim/render/content/content.h"

namespace rigor::nature {

using Colour = std::array<float, 3>;

class Canvas {
 public:
  Canvas(int width, int height)
      : width_(width), height_(height), texels_(static_cast<std::size_t>(width) * height) {}
  struct Texel {
    Colour colour{};
    float alpha = 0;
  };
  [[nodiscard]] int width() const { return width_; }
  [[nodiscard]] int height() const { return height_; }
  [[nodiscard]] Texel& at(int x, int y) { return texels_[static_cast<std::size_t>(y) * width_ + x]; }
  [[nodiscard]] const Texel& at(int x, int y) const {
    return texels_[static_cast<std::size_t>(y) * width_ + x];
  }

  /// What is drawn stays inside.
  struct Clip {
    int x0, y0, x1, y1;
  };
  void set_clip(Clip c) { clip_ = c; }

  /// A line with round ends, its edges smoothed over one texel; width falls from w0 to w1.
  void line(float x0, float y0, float x1, float y1, float w0, float w1, const Colour& colour) {
    const float reach = 0.5F * std::max(w0, w1) + 1;
    const float dx = x1 - x0, dy = y1 - y0, length2 = dx * dx + dy * dy;
    const float least = std::max(w0, w1) + 1.001F;  // twice the distance beyond which the line covers nothing
    each(std::min(x0, x1) - reach, std::min(y0, y1) - reach, std::max(x0, x1) + reach,
         std::max(y0, y1) + reach, [&](float x, float y, Texel& t) {
           const float s =
               length2 > 0 ? std::clamp(((x - x0) * dx + (y - y0) * dy) / length2, 0.0F, 1.0F) : 0;
           const double off_x = static_cast<double>(x - x0 - s * dx),
                        off_y = static_cast<double>(y - y0 - s * dy), off2 = off_x * off_x + off_y * off_y;
           if (4 * off2 > static_cast<double>(least * least)) return;
           const auto d = static_cast<float>(std::sqrt(off2));
           put(t, std::clamp(0.5F * (w0 + s * (w1 - w0)) + 0.5F - d, 0.0F, 1.0F), colour);
         });
  }
  /// A pointed leaf from its stalk along (dx, dy); a paler midrib.
  void leaf(float x0, float y0, float dx, float dy, float half_width, const Colour& colour) {
    const float length = std::hypot(dx, dy);
    if (!(length > 0)) return;
    const float ax = dx / length, ay = dy / length;
    const float reach = half_width + 1;
    each(std::min(x0, x0 + dx) - reach, std::min(y0, y0 + dy) - reach, std::max(x0, x0 + dx) + reach,
         std::max(y0, y0 + dy) + reach, [&](float x, float y, Texel& t) {
           const float along = (x - x0) * ax + (y - y0) * ay,
                       across = std::fabs((y - y0) * ax - (x - x0) * ay);
           const float s = along / length;
           if (s < 0 || s > 1) return;
           const float w =
               half_width * std::pow(std::max(0.0F, std::sin(3.14159265F * std::pow(s, 0.8F))), 0.7F);
           const float rib = across < 0.09F * half_width + 0.4F
                                 ? 1.12F
                                 : 1.0F - 0.12F * across / std::max(half_width, 1.0F);
           put(t, std::clamp(w + 0.5F - across, 0.0F, 1.0F),
               {colour[0] * rib, colour[1] * rib, colour[2] * rib});
         });
  }

 private:
  template <class F>
  void each(float x0, float y0, float x1, float y1, F&& f) {
    const int ix0 = std::max(clip_.x0, static_cast<int>(std::floor(x0))),
              iy0 = std::max(clip_.y0, static_cast<int>(std::floor(y0)));
    const int ix1 = std::min(clip_.x1, static_cast<int>(std::ceil(x1)) + 1),
              iy1 = std::min(clip_.y1, static_cast<int>(std::ceil(y1)) + 1);
    for (int y = iy0; y < iy1; ++y)
      for (int x = ix0; x < ix1; ++x) f(static_cast<float>(x) + 0.5F, static_cast<float>(y) + 0.5F, at(x, y));
  }
  static void put(Texel& t, float a, const Colour& c) {
    if (a <= 0) return;
    const float all = a + t.alpha * (1 - a);
    for (int k = 0; k < 3; ++k) t.colour[k] = (c[k] * a + t.colour[k] * t.alpha * (1 - a)) / all;
    t.alpha = all;
  }
  int width_, height_;
  Clip clip_{0, 0, 0, 0};
  std::vector<Texel> texels_;
};

}  // namespace rigor::nature
