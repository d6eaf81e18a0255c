#include <mutex>
#include <numbers>

#include "sim/nature/trees/canvas.h"
#include "sim/nature/trees/draws.h"
#include "sim/nature/trees/tree_textures.h"
#include "sim/render/content/surface_library.h"
#include "sim/render/content/texels.h"

namespace rigor::nature {
namespace {

constexpr int kAtlas_px = 1024;
constexpr float kPi = std::numbers::pi_v<float>;

/// How the shoots of a kind of tree are built. Lengths in metres of the plant.
struct ShootStyle {
  bool leaves = false;  ///< broad ones
  float needle_m = 0.012F, needle_angle = 0.9F, needle_step_m = 0.0035F;
  float needle_width_m = 0.0028F;
  float tuft_step_m = 0;  ///< above 0: needles in tufts that far apart
  float twig_width_m = 0.003F;
  float side_angle = 0.85F, side_step_m = 0.035F, side_ratio = 0.42F;
  float twig_ratio = 0.29F;    ///< of a twig's own side shoots
  float sweep = 0.25F;         ///< side shoots bend forward by so much, rad
  float bare = 0.0F;           ///< share of a last-order twig, from its base, without needles
  int twig_levels = 1;         ///< orders of side shoots on a twig card
  float bough_step_m = 0.24F;  ///< between the twigs of a bough
  float leaf_m = 0.08F, leaf_slender = 0.3F;
  float fill = 0.155F;  ///< short twigs with leaves on a square of a leaf's length
  Colour young{0.95F, 0.97F, 0.85F}, old{0.66F, 0.68F, 0.70F};
  float twig_scale_m = 0.8F, bough_scale_m = 3.2F;  ///< length that fills a cell
};

ShootStyle style_of(TreeForm form) {
  ShootStyle s;
  switch (form) {
    case TreeForm::spruce:
      s.needle_m = 0.016F, s.needle_angle = 0.75F, s.side_angle = 0.75F, s.side_ratio = 0.40F;
      break;
    case TreeForm::fir:
      s.needle_m = 0.022F, s.needle_angle = 1.1F, s.needle_width_m = 0.0032F, s.side_angle = 0.95F;
      s.side_ratio = 0.40F, s.side_step_m = 0.05F;
      break;
    case TreeForm::hemlock:
      s.needle_m = 0.013F, s.needle_angle = 1.15F, s.side_angle = 0.9F, s.side_step_m = 0.03F;
      s.side_ratio = 0.36F, s.sweep = 0.35F;
      break;
    case TreeForm::douglas_fir:
      s.needle_m = 0.024F, s.needle_angle = 0.95F, s.side_angle = 0.8F, s.side_step_m = 0.05F;
      break;
    case TreeForm::cedar:
      s.needle_m = 0.006F, s.needle_angle = 0.5F, s.needle_step_m = 0.004F, s.needle_width_m = 0.005F;
      s.twig_width_m = 0.005F, s.side_angle = 0.65F, s.side_step_m = 0.022F, s.side_ratio = 0.4F,
      s.sweep = 0.3F;
      s.twig_levels = 2;
      break;
    case TreeForm::yew:
      s.needle_m = 0.026F, s.needle_angle = 1.2F, s.side_step_m = 0.045F, s.side_ratio = 0.45F;
      s.young = {0.9F, 0.9F, 0.8F};
      break;
    case TreeForm::pine:
      s.needle_m = 0.07F, s.needle_angle = 0.65F, s.needle_step_m = 0.007F, s.needle_width_m = 0.003F;
      s.side_angle = 0.8F, s.side_step_m = 0.13F, s.side_ratio = 0.42F, s.bare = 0.45F,
      s.twig_width_m = 0.006F;
      break;
    case TreeForm::larch:
      s.needle_m = 0.032F, s.tuft_step_m = 0.022F, s.side_angle = 0.9F, s.side_step_m = 0.06F;
      s.side_ratio = 0.40F, s.needle_width_m = 0.0026F, s.twig_width_m = 0.004F;
      break;
    case TreeForm::oak:
      s.leaves = true, s.leaf_m = 0.10F, s.leaf_slender = 0.34F, s.side_angle = 0.9F, s.side_step_m = 0.11F;
      s.side_ratio = 0.5F, s.twig_width_m = 0.006F;
      break;
    case TreeForm::beech:
      s.leaves = true, s.leaf_m = 0.085F, s.leaf_slender = 0.36F, s.side_angle = 0.75F, s.side_step_m = 0.09F;
      s.side_ratio = 0.5F, s.twig_width_m = 0.005F;
      break;
    case TreeForm::birch:
      s.leaves = true, s.leaf_m = 0.06F, s.leaf_slender = 0.36F, s.fill = 0.085F, s.side_angle = 0.6F,
      s.side_step_m = 0.09F;
      s.side_ratio = 0.45F, s.twig_width_m = 0.003F, s.sweep = 0.1F;
      break;
    case TreeForm::shrub:
      s.leaves = true, s.leaf_m = 0.075F, s.leaf_slender = 0.38F, s.side_angle = 0.8F, s.side_step_m = 0.10F;
      s.side_ratio = 0.5F, s.twig_width_m = 0.005F;
      break;
  }
  if (s.leaves) s.twig_scale_m = 1.35F, s.bough_scale_m = 2.7F;
  return s;
}

/// Draws shoots: an axis with side shoots of the next lower order, down to twigs with needles or leaves.
struct ShootPainter {
  Canvas& canvas;
  const ShootStyle& style;
  Draws draws;
  float px_per_m, tone;
  int orders = 1;  ///< of the whole picture
  std::uint32_t count = 0;

  float next() { return draws.uniform(1, count++); }
  Colour green(float age) {  // 0 young … 1 old
    const float light = tone * (0.86F + 0.28F * next());
    Colour c{};
    for (int k = 0; k < 3; ++k) c[k] = light * (style.young[k] + age * (style.old[k] - style.young[k]));
    return c;
  }
  Colour wood() const { return {0.95F * tone, 0.50F * tone, 0.75F * tone}; }

  void twig(float x, float y, float angle, float length_px, float bend) {
    const int steps = std::max(2, static_cast<int>(length_px / 4));
    const float step = length_px / static_cast<float>(steps),
                width = std::max(1.1F, style.twig_width_m * px_per_m);
    struct Point {
      float x, y, a;
    };
    std::vector<Point> path{{x, y, angle}};
    for (int i = 0; i < steps; ++i) {
      const float a = path.back().a + bend / static_cast<float>(steps);
      path.push_back({path.back().x + step * std::sin(a), path.back().y - step * std::cos(a), a});
    }
    const auto on = [&](float s) {
      const float f = s * static_cast<float>(steps);
      const int i = std::min(steps - 1, static_cast<int>(f));
      const float r = f - static_cast<float>(i);
      return Point{path[i].x + r * (path[i + 1].x - path[i].x), path[i].y + r * (path[i + 1].y - path[i].y),
                   path[i].a};
    };
    const bool green_stem = style.needle_width_m > 0.004F;
    for (int i = 0; i < steps; ++i)
      canvas.line(path[i].x, path[i].y, path[i + 1].x, path[i + 1].y, width, width,
                  green_stem ? green(0.6F) : wood());
    if (style.leaves) {
      const int n = std::max(2, static_cast<int>(length_px / (0.5F * style.leaf_m * px_per_m)));
      for (int i = 0; i <= n; ++i) {
        const Point p = on(static_cast<float>(i) / static_cast<float>(n));
        const float side = i == n ? 0.0F : (i % 2 ? 1.0F : -1.0F);
        const float a = p.a + side * (0.75F + 0.5F * next());
        const float l = style.leaf_m * px_per_m * (0.75F + 0.4F * next());
        canvas.leaf(p.x, p.y, l * std::sin(a), -l * std::cos(a),
                    style.leaf_slender * l * (0.7F + 0.4F * next()), green(next()));
      }
      return;
    }
    const float needle = std::max(1.6F, style.needle_m * px_per_m),
                thick = std::max(1.15F, style.needle_width_m * px_per_m);
    if (style.tuft_step_m > 0) {
      const int n = std::max(2, static_cast<int>(length_px / std::max(3.0F, style.tuft_step_m * px_per_m)));
      for (int i = 0; i <= n; ++i) {
        const Point p = on(static_cast<float>(i) / static_cast<float>(n));
        for (int k = 0; k < 11; ++k) {
          const float a = p.a + kPi * (next() * 2 - 1) * 0.85F, l = needle * (0.6F + 0.5F * next());
          canvas.line(p.x, p.y, p.x + l * std::sin(a), p.y - l * std::cos(a), thick, 0.8F,
                      green(0.5F * next()));
        }
      }
      return;
    }
    const int n = std::max(3, static_cast<int>(length_px / std::max(1.3F, style.needle_step_m * px_per_m)));
    for (int i = 0; i <= n; ++i) {
      const float s = style.bare + (1 - style.bare) * static_cast<float>(i) / static_cast<float>(n);
      const Point p = on(s);
      for (int side = -1; side <= 1; side += 2) {
        const float a = p.a + static_cast<float>(side) * style.needle_angle * (0.75F + 0.5F * next()) *
                                  (s > 0.93F ? 0.5F : 1.0F);
        const float l = needle * (0.75F + 0.4F * next());
        canvas.line(p.x, p.y, p.x + l * std::sin(a), p.y - l * std::cos(a), thick, 0.9F, green(1 - s));
      }
    }
  }

  void shoot(float x, float y, float angle, float length_px, int order, float bend) {
    if (order == 0) return twig(x, y, angle, length_px, bend);
    // Side shoots of a bough are whole twigs, with the sky between them.
    float spacing = style.side_step_m * px_per_m;
    for (int k = 1; k < order; ++k) spacing *= 3.3F;
    if (order > style.twig_levels) spacing = style.bough_step_m * px_per_m;
    spacing = std::max(spacing, 4.0F);
    const int n = std::max(3, static_cast<int>(length_px * 0.92F / spacing));
    const float width =
        std::max(1.3F, style.twig_width_m * px_per_m * (1 + 0.8F * static_cast<float>(order)));
    const auto on = [&](float s) {
      const float a = angle + 0.5F * bend * s;
      return std::array<float, 2>{x + s * length_px * std::sin(a), y - s * length_px * std::cos(a)};
    };
    for (int i = 0; i < 8; ++i) {
      const auto p = on(static_cast<float>(i) / 8), q = on(static_cast<float>(i + 1) / 8);
      const float w = width * (1 - 0.8F * static_cast<float>(i) / 8);
      canvas.line(p[0], p[1], q[0], q[1], w, w, wood());
    }
    const float light = tone;
    for (int i = 0; i < n; ++i) {
      for (int side = -1; side <= 1; side += 2) {
        const float s = 0.05F + 0.93F * (static_cast<float>(i) + 0.8F * next()) / static_cast<float>(n);
        const auto p = on(s);
        // A lance: longest at a third, short at the tip; ragged, and some are gone.
        const float lance = std::pow(s < 0.28F ? 0.45F + 0.55F * s / 0.28F : (1.04F - s) / 0.76F, 0.8F);
        const float l = length_px *
                        (order < orders && order == style.twig_levels ? style.twig_ratio : style.side_ratio) *
                        lance * (order > 1 ? 0.4F + 0.75F * next() : 0.45F + 0.75F * next());
        const float f = static_cast<float>(side),
                    a = angle + bend * s +
                        f * style.side_angle * (1.05F - 0.35F * s) * (0.8F + 0.4F * next());
        if (next() < (order > 1 ? 0.08F : 0.12F)) continue;
        // What is near the base lies in the shade of the rest; every twig catches its own light.
        tone = light * (order > 1 ? (0.55F + 0.6F * s) * (0.75F + 0.5F * next()) : 0.85F + 0.3F * next());
        shoot(p[0], p[1], a, l, order - 1, -f * style.sweep);
        tone = light;
      }
    }
    const auto tip = on(0.93F);
    shoot(tip[0], tip[1], angle + bend, length_px * 0.10F, 0, 0);
  }

  /// Broad leaves: short twigs that keep their distance from one another, so that small gaps are left at
  /// every size of the picture and no large outline shows; joined by thin wood to an axis.
  void spray(float x, float y, float length_px, float width_px) {
    const float leaf = style.leaf_m * px_per_m;
    const int twigs = std::max(6, static_cast<int>(style.fill * length_px * width_px / (leaf * leaf)));
    std::vector<std::array<float, 2>> places;
    const float turn = 6.28F * next();
    for (int i = 0; i < twigs; ++i) {
      std::array<float, 2> best{x, y - 0.5F * length_px};
      float best_gap = -1;
      for (int trial = 0; trial < 7; ++trial) {
        const float along = 0.08F + 0.86F * next(), across = 2 * next() - 1;
        // An egg with a wavy edge.
        const float reach = 0.45F * width_px * std::pow(std::sin(kPi * std::pow(along, 0.75F)), 0.6F) *
                            (0.82F + 0.18F * std::sin(turn + 17 * along + (across > 0 ? 2.0F : 0.0F)));
        const std::array<float, 2> at{x + across * reach, y - along * length_px};
        float gap = 1e9F;
        for (const auto& q : places) gap = std::min(gap, std::hypot(at[0] - q[0], at[1] - q[1]));
        if (gap > best_gap) best_gap = gap, best = at;
      }
      places.push_back(best);
    }
    const float light = tone, thin = std::max(1.1F, style.twig_width_m * px_per_m);
    canvas.line(x, y, x, y - 0.8F * length_px, 1.8F * thin, thin, wood());
    for (const auto& p : places) {
      const float foot = std::min(y, p[1] + 0.8F * std::fabs(p[0] - x) + leaf);
      tone = 0.8F * light;
      canvas.line(x, foot, p[0], p[1], thin, 1.1F, wood());
    }
    for (const auto& p : places) {
      const float s = (y - p[1]) / length_px;
      tone = light * (0.70F + 0.36F * s) * (0.62F + 0.6F * next());
      const float angle = 1.2F * (p[0] - x) / (0.5F * width_px) + 1.6F * (next() - 0.5F);
      const float l = leaf * (1.1F + 0.9F * next());
      twig(p[0] - 0.5F * l * std::sin(angle), p[1] + 0.5F * l * std::cos(angle), angle, l, next() - 0.5F);
    }
    tone = light;
  }
};

/// Under texels without coverage stands the mean of what is near, so that filtering makes no dark seams.
void fill_background(Canvas& canvas, const Colour& mean) {
  for (int y = 0; y < canvas.height(); ++y)
    for (int x = 0; x < canvas.width(); ++x) {
      Canvas::Texel& t = canvas.at(x, y);
      if (t.alpha < 1)
        for (int k = 0; k < 3; ++k) t.colour[k] = t.alpha * t.colour[k] + (1 - t.alpha) * mean[k];
    }
}

FoliageSurface make(TreeForm form) {
  const ShootStyle style = style_of(form);
  Canvas canvas(kAtlas_px, kAtlas_px);
  FoliageSurface out{};
  for (int cell = 0; cell <= kBoughCell; ++cell) {
    const AtlasCell c = atlas_cell(cell);
    const auto px = [](float u) { return static_cast<int>(std::lround(u * kAtlas_px)); };
    canvas.set_clip({px(c.u0) + 2, px(c.v0) + 2, px(c.u1) - 2, px(c.v1) - 2});
    const float height = (c.v1 - c.v0) * kAtlas_px, x = 0.5F * (c.u0 + c.u1) * kAtlas_px,
                y = c.v1 * kAtlas_px - 2;
    const bool bough = cell == kBoughCell;
    const float length = height * 0.93F;
    const float scale = (bough ? style.bough_scale_m : style.twig_scale_m);
    ShootPainter painter{canvas,
                         style,
                         Draws("foliage_texture", static_cast<std::uint64_t>(form) * 16 + cell),
                         length / scale,
                         bough ? 0.9F : (cell < 2 ? 0.92F : 0.78F),
                         bough ? style.twig_levels + 1 : style.twig_levels};
    if (style.leaves)
      painter.spray(x, y, length, (c.u1 - c.u0) * kAtlas_px);
    else
      painter.shoot(x, y, 0.0F, length, painter.orders, 0.0F);
  }
  std::array<double, 3> sum{};
  double weight = 0;
  for (int y = 0; y < kAtlas_px; ++y)
    for (int x = 0; x < kAtlas_px; ++x) {
      const auto& t = canvas.at(x, y);
      for (int k = 0; k < 3; ++k) sum[k] += t.alpha * std::min(1.0F, t.colour[k]);
      weight += t.alpha;
    }
  Colour mean{};
  for (int k = 0; k < 3; ++k) mean[k] = static_cast<float>(sum[k] / weight);
  fill_background(canvas, mean);

  const render::SrgbBytes& bytes = render::srgb_bytes();
  auto texture = std::make_shared<render::Texture>();
  texture->width = texture->height = kAtlas_px;
  texture->repeat = false;
  texture->rgba.resize(static_cast<std::size_t>(kAtlas_px) * kAtlas_px * 4);
  for (std::size_t i = 0; i < static_cast<std::size_t>(kAtlas_px) * kAtlas_px; ++i) {
    const auto& t = canvas.at(static_cast<int>(i % kAtlas_px), static_cast<int>(i / kAtlas_px));
    for (int k = 0; k < 3; ++k) texture->rgba[4 * i + k] = bytes.of(t.colour[k]);
    texture->rgba[4 * i + 3] = static_cast<std::uint8_t>(std::lround(255 * t.alpha));
  }
  constexpr float kCutoff = 0.35F;
  for (int cell = 0; cell <= kBoughCell; ++cell) {
    const AtlasCell c = atlas_cell(cell);
    std::size_t in = 0, all = 0;
    for (int y = static_cast<int>(c.v0 * kAtlas_px); y < static_cast<int>(c.v1 * kAtlas_px); ++y)
      for (int x = static_cast<int>(c.u0 * kAtlas_px); x < static_cast<int>(c.u1 * kAtlas_px); ++x, ++all)
        in += canvas.at(x, y).alpha >= kCutoff;
    out.coverage[cell] = static_cast<float>(in) / static_cast<float>(all);
  }
  // In the near infrared leaves differ little: one texel.
  auto flat = std::make_shared<render::Texture>();
  flat->width = flat->height = 1;
  flat->srgb = false;
  flat->rgba = {255, 255, 255, 255};

  auto surface = std::make_shared<render::Surface>();
  const bool needles = is_conifer(form);
  *surface = *render::SurfaceLibrary::builtin().get(needles ? "needles" : "broad_leaves");
  surface->serial = render::next_serial();
  for (int b = 0; b < 3; ++b) {
    surface->reflectance[b] /= mean[b];
    surface->transmittance[b] /= mean[b];
  }
  surface->colour_map = texture;
  surface->near_infrared_map = flat;
  surface->alpha_cutoff = kCutoff;
  surface->two_sided = true;
  out.surface = surface;
  // Leaf after leaf takes visible light away; near infrared comes through, and a lidar's own beam sees a leaf
  // as it is.
  auto inner = std::make_shared<render::Surface>(*surface);
  inner->serial = render::next_serial();
  for (int b = 0; b < 3; ++b) {
    inner->reflectance[b] *= kInnerLight;
    inner->transmittance[b] *= kInnerLight;
  }
  out.inner = inner;
  return out;
}

}  // namespace

const FoliageSurface& foliage_surface(TreeForm form) {
  // One slot per form, each made when first asked for.
  static const auto slots = [] {
    struct Slot {
      std::once_flag once;
      FoliageSurface value;
    };
    return std::make_unique<std::array<Slot, kTreeFormCount>>();
  }();
  auto& slot = (*slots)[static_cast<std::size_t>(form)];
  std::call_once(slot.once, [&] { slot.value = make(form); });
  return slot.value;
}

}  // namespace rigor::nature
