#include <mutex>
#include <numbers>

#include "sim/nature/trees/canvas.h"
#include "sim/nature/trees/draws.h"
#include "sim/nature/trees/tree_textures.h"
#include "sim/render/content/surface_library.h"
#include "sim/render/content/texels.h"

namespace rigor::nature {
namespace {

constexpr int kBark_px = 256;

/// Smooth noise that repeats after `period` lattice cells; 0 … 1.
struct TiledNoise {
  Draws draws;
  [[nodiscard]] float at(float u, float v, int period_u, int period_v, std::uint32_t layer) const {
    const float x = u * static_cast<float>(period_u), y = v * static_cast<float>(period_v);
    const int ix = static_cast<int>(std::floor(x)), iy = static_cast<int>(std::floor(y));
    const auto ease = [](float t) { return t * t * (3 - 2 * t); };
    const float fx = ease(x - static_cast<float>(ix)), fy = ease(y - static_cast<float>(iy));
    const auto lattice = [&](int i, int j) {
      const int a = ((i % period_u) + period_u) % period_u, b = ((j % period_v) + period_v) % period_v;
      return draws.uniform(layer, static_cast<std::uint32_t>(b * period_u + a));
    };
    const float top = lattice(ix, iy) + fx * (lattice(ix + 1, iy) - lattice(ix, iy));
    const float bottom = lattice(ix, iy + 1) + fx * (lattice(ix + 1, iy + 1) - lattice(ix, iy + 1));
    return top + fy * (bottom - top);
  }
};

/// Height of the bark (0 crack … 1 crest) and a factor of its brightness.
struct BarkPoint {
  float height, light;
};
BarkPoint bark_at(BarkStyle style, const TiledNoise& n, float u, float v) {
  constexpr float kTwoPi = 2 * std::numbers::pi_v<float>;
  const float fine = n.at(u, v, 64, 64, 9), grain = n.at(u, v, 32, 24, 8);
  switch (style) {
    case BarkStyle::smooth: {
      // Grey skin with pale patches of lichen, faint cross bands and small blisters.
      const float band = n.at(u, v, 6, 56, 1), patch = n.at(u, v, 5, 7, 2), lichen = n.at(u, v, 18, 26, 3);
      const float blister = std::clamp((n.at(u, v, 24, 70, 4) - 0.7F) / 0.25F, 0.0F, 1.0F);
      const float pale = std::clamp((patch + 0.5F * lichen - 0.7F) / 0.35F, 0.0F, 1.0F);
      return {0.5F + 0.2F * (band - 0.5F) + 0.3F * blister + 0.15F * (fine - 0.5F),
              0.62F + 0.20F * pale + 0.10F * (band - 0.5F) + 0.08F * (grain - 0.5F) - 0.10F * blister};
    }
    case BarkStyle::ridged: {
      const float warp = 0.35F * (n.at(u, v, 5, 4, 1) - 0.5F) + 0.14F * (n.at(u, v, 9, 12, 2) - 0.5F);
      const float wave = 0.5F + 0.5F * std::cos(kTwoPi * (7 * u + 3 * warp));
      const float broken = n.at(u, v, 12, 16, 3);
      const float h = std::pow(wave, 0.6F) * (0.65F + 0.5F * broken);
      return {h + 0.2F * (fine - 0.5F), 0.30F + 0.55F * h + 0.15F * grain};
    }
    case BarkStyle::scaly: {
      const float warp = 0.4F * (n.at(u, v, 6, 6, 1) - 0.5F);
      const float columns = 0.5F + 0.5F * std::cos(kTwoPi * (9 * u + 2 * warp));
      const float rows = 0.5F + 0.5F * std::cos(kTwoPi * (13 * v + 2.5F * n.at(u, v, 9, 8, 2)));
      const float h = std::pow(std::max(0.0F, columns * (0.45F + 0.55F * rows)), 0.45F);
      return {h + 0.15F * (fine - 0.5F), 0.45F + 0.38F * h + 0.2F * (n.at(u, v, 9, 13, 3) - 0.4F)};
    }
    case BarkStyle::fibrous: {
      const float warp = 0.12F * (n.at(u, v, 4, 3, 1) - 0.5F);
      const float strip = n.at(u + warp, v, 22, 3, 2), thread = n.at(u + warp, v, 60, 8, 3);
      const float h = 0.6F * strip + 0.4F * thread;
      return {h, 0.40F + 0.55F * h + 0.1F * (grain - 0.5F)};
    }
    case BarkStyle::birch: {
      const float band = n.at(u, v, 3, 48, 1), mark = n.at(u, v, 6, 22, 2), scar = n.at(u, v, 4, 6, 3);
      const bool lenticel = mark > 0.74F && band > 0.45F, plate = scar > 0.83F;
      const float light = plate ? 0.12F : lenticel ? 0.22F : 0.88F + 0.1F * band;
      return {plate ? 0.2F + 0.5F * fine : 0.6F, light};
    }
  }
  return {0.5F, 0.5F};
}

std::shared_ptr<const render::Surface> make(BarkStyle style) {
  const TiledNoise noise{Draws("bark_texture", static_cast<std::uint64_t>(style))};
  std::vector<BarkPoint> points(static_cast<std::size_t>(kBark_px) * kBark_px);
  for (int y = 0; y < kBark_px; ++y)
    for (int x = 0; x < kBark_px; ++x)
      points[static_cast<std::size_t>(y) * kBark_px + x] = bark_at(
          style, noise, (static_cast<float>(x) + 0.5F) / kBark_px, (static_cast<float>(y) + 0.5F) / kBark_px);
  double mean = 0;
  for (BarkPoint& p : points) {
    p.light = std::clamp(p.light, 0.05F, 1.0F);
    mean += p.light;
  }
  mean /= static_cast<double>(points.size());

  const render::SrgbBytes& bytes = render::srgb_bytes();
  auto colour = std::make_shared<render::Texture>();
  auto normal = std::make_shared<render::Texture>();
  colour->width = colour->height = normal->width = normal->height = kBark_px;
  normal->srgb = false;
  const float depth_m = style == BarkStyle::ridged                                ? 0.03F
                        : style == BarkStyle::smooth || style == BarkStyle::birch ? 0.004F
                                                                                  : 0.015F;
  const auto height = [&](int x, int y) {
    return points[static_cast<std::size_t>((y + kBark_px) % kBark_px) * kBark_px + (x + kBark_px) % kBark_px]
               .height *
           depth_m;
  };
  for (int y = 0; y < kBark_px; ++y)
    for (int x = 0; x < kBark_px; ++x) {
      const BarkPoint& p = points[static_cast<std::size_t>(y) * kBark_px + x];
      const std::uint8_t byte = bytes.of(p.light);
      colour->rgba.insert(colour->rgba.end(), {byte, byte, byte, 255});
      const float du = (height(x + 1, y) - height(x - 1, y)) / (2 * kBarkWidth_m / kBark_px);
      const float dv = (height(x, y + 1) - height(x, y - 1)) / (2 * kBarkHeight_m / kBark_px);
      // Rows go down, the normal's second component up.
      const Eigen::Vector3f n = Eigen::Vector3f(-du, dv, 1).normalized();
      for (int k = 0; k < 3; ++k)
        normal->rgba.push_back(static_cast<std::uint8_t>(std::lround(127.5F + 127.5F * n[k])));
      normal->rgba.push_back(255);
    }
  auto surface = std::make_shared<render::Surface>();
  *surface = *render::SurfaceLibrary::builtin().get("bark");
  surface->serial = render::next_serial();
  // Betulin makes birch bark white and its near infrared brighter (approximate).
  if (style == BarkStyle::birch) surface->reflectance = {0.46F, 0.44F, 0.40F, 0.55F, 0.56F, 0.50F};
  for (float& r : surface->reflectance) r = std::min(1.0F, r / static_cast<float>(mean));
  surface->colour_map = colour;
  surface->normal_map = normal;
  return surface;
}

}  // namespace

std::shared_ptr<const render::Surface> bark_surface(BarkStyle style) {
  struct Slot {
    std::once_flag once;
    std::shared_ptr<const render::Surface> value;
  };
  static const auto slots = std::make_unique<std::array<Slot, kBarkStyleCount>>();
  Slot& slot = (*slots)[static_cast<std::size_t>(style)];
  std::call_once(slot.once, [&] { slot.value = make(style); });
  return slot.value;
}

}  // namespace rigor::nature
