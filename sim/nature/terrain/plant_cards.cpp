#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <numbers>
#include <vector>

#include "sim/nature/terrain/noise.h"
#include "sim/nature/terrain/plants.h"
#include "sim/render/content/texels.h"

namespace rigor::nature {
namespace {

using std::numbers::pi;

/// What a card shows at (u, v), v from the bottom: covered or not, and its colour as factors.
struct Ink {
  bool there = false;
  std::array<double, 3> colour{1, 1, 1};
};
double draw(std::uint32_t stream, int i, int word) {
  return unit_from_word(place_words(0x706C616E7473ULL, stream, i, 0)[static_cast<std::size_t>(word)]);
}

Ink shade(double s) { return {true, {s, s, s}}; }

template <class Painter>
CardPicture paint(std::uint32_t width, std::uint32_t height, const Painter& painter) {
  constexpr int kSub = 4;
  auto t = std::make_shared<render::Texture>();
  t->width = width;
  t->height = height;
  t->repeat = false;
  t->rgba.resize(static_cast<std::size_t>(width) * height * 4);
  std::vector<std::array<double, 4>> texels(static_cast<std::size_t>(width) * height);
  std::array<double, 4> sum{};
  for (std::uint32_t j = 0; j < height; ++j) {
    for (std::uint32_t i = 0; i < width; ++i) {
      auto& texel = texels[static_cast<std::size_t>(j) * width + i];
      for (int k = 0; k < kSub * kSub; ++k) {
        const double u = (i + (k % kSub + 0.5) / kSub) / width,
                     v = 1 - (j + (k / kSub + 0.5) / kSub) / height;
        const Ink ink = painter(u, v);
        if (!ink.there) continue;
        for (std::size_t c = 0; c < 3; ++c) texel[c] += ink.colour[c];
        texel[3] += 1;
      }
      for (std::size_t c = 0; c < 4; ++c) sum[c] += texel[c];
    }
  }
  const render::SrgbBytes& bytes = render::srgb_bytes();
  CardPicture out;
  std::array<double, 3> mean{};
  for (std::size_t c = 0; c < 3; ++c) mean[c] = sum[c] / sum[3];
  for (std::size_t i = 0; i < texels.size(); ++i) {
    const auto& texel = texels[i];
    for (std::size_t c = 0; c < 3; ++c) {
      // Where nothing is, the mean: so that no dark fringe comes in by filtering.
      const double v = texel[3] > 0 ? texel[c] / texel[3] : mean[c];
      t->rgba[4 * i + c] = bytes.of(static_cast<float>(v));
    }
    t->rgba[4 * i + 3] = static_cast<std::uint8_t>(std::lround(255 * texel[3] / (kSub * kSub)));
  }
  for (std::size_t c = 0; c < 3; ++c) out.mean[c] = static_cast<float>(mean[c]);
  out.coverage = static_cast<float>(sum[3] / (kSub * kSub * static_cast<double>(texels.size())));
  out.texture = std::move(t);
  return out;
}

/// A blade: its foot in the thatch is dark and brown, its tip bright; a midrib.
Ink blade(double u, double v) {
  const double light = 0.38 + 0.52 * std::pow(v, 0.7), rib = std::abs(u - 0.5) < 0.12 ? 0.88 : 1.0;
  const double brown = std::exp(-v * 5);
  return {true,
          {std::min(1.0, light * rib * (1 + 0.25 * brown)), light * rib, light * rib * (1 - 0.2 * brown)}};
}

// What lies on top is asked for first, and what a part may reach at most before its outline: the pictures are
// asked for at millions of places.

class Tuft {
 public:
  Tuft() {
    for (int i = 0; i < kBlades; ++i)
      blades_[i] = {0.55 + 0.44 * draw(1, i, 0), 0.5 + 0.34 * (draw(1, i, 1) - 0.5),
                    0.85 * (draw(1, i, 2) - 0.5), 0.8 + 0.2 * draw(1, i, 3)};
  }
  Ink operator()(double u, double v) const {
    for (int i = kBlades - 1; i >= 0; --i) {
      const Blade& b = blades_[i];
      const double t = v / b.top;
      if (t >= 1) continue;
      const double half = 0.021 * (1 - 0.9 * t * t) + 0.004;
      if (std::abs(u - (b.foot + b.lean * t * t)) > half) continue;
      Ink out = blade(0.5, t);
      for (double& c : out.colour) c *= b.tone;
      return out;
    }
    return {};
  }

 private:
  static constexpr int kBlades = 17;
  struct Blade {
    double top, foot, lean, tone;
  };
  Blade blades_[kBlades];
};

/// Pinnae on both sides of a rachis along v.
class Frond {
 public:
  Frond() {
    for (int side = 0; side < 2; ++side)
      for (int k = 0; k < kPinnae; ++k) {
        const double foot = 0.10 + 0.88 * (k + (side == 1 ? 0.0 : 0.4)) / kPinnae;
        const double envelope = 0.47 * std::pow(std::sin(pi * std::min(1.0, 0.12 + 0.88 * (1 - foot))), 0.8);
        pinnae_[side][k] = {foot, std::max(0.03, envelope)};
      }
  }
  Ink operator()(double u, double v) const {
    const double across = std::abs(u - 0.5);
    if (across < 0.012 * (1.2 - v) && v < 0.985) return shade(0.55);
    for (const Pinna& p : pinnae_[u < 0.5 ? 0 : 1]) {
      const double along = across / p.length;  // pinnae rise towards the tip
      const double middle = p.foot + 0.055 * along + 0.02 * along * along;
      if (along > 1 || std::abs(v - middle) > 0.0166) continue;
      const double lobes = 0.85 + 0.15 * std::cos(across * 190);
      const double half = 0.0165 * std::pow(1 - along, 0.55) * lobes;
      if (std::abs(v - middle) < half) {
        return shade((0.72 + 0.22 * along) * (std::abs(v - middle) < 0.12 * half ? 0.8 : 1.0) *
                     (0.9 + 0.1 * v));
      }
    }
    return {};
  }

 private:
  static constexpr int kPinnae = 22;
  struct Pinna {
    double foot, length;
  };
  std::array<Pinna, kPinnae> pinnae_[2];  ///< left, right
};

/// A whole fern from the side: arching fronds.
class FernSide {
 public:
  FernSide() {
    for (int i = 0; i < kFronds; ++i) {
      const double lean = (i - 4) / 4.0, reach = 0.47 * std::abs(lean), rise = 0.98 - 0.35 * lean * lean;
      Arch& arch = arches_[i];
      for (int k = 1; k <= kSteps; ++k) {
        const double t = static_cast<double>(k) / kSteps;
        arch.x[k - 1] = 0.5 + (lean < 0 ? -1 : 1) * reach * t;
        arch.y[k - 1] = rise * t * (1.55 - 0.55 * t - 0.35 * std::abs(lean) * t);
      }
      const auto [x0, x1] = std::minmax_element(arch.x, arch.x + kSteps);
      const auto [y0, y1] = std::minmax_element(arch.y, arch.y + kSteps);
      arch.x0 = *x0 - kWidest, arch.x1 = *x1 + kWidest, arch.y0 = *y0 - kWidest, arch.y1 = *y1 + kWidest;
      arch.tone = 0.8 + 0.2 * draw(3, i, 0);
    }
  }
  Ink operator()(double u, double v) const {
    for (int i = kFronds - 1; i >= 0; --i) {
      const Arch& arch = arches_[i];
      if (u < arch.x0 || u > arch.x1 || v < arch.y0 || v > arch.y1) continue;
      // The arch as a parabola over t; the nearest t by a few steps.
      double least = 1e9;
      int nearest = 0;
      for (int k = 0; k < kSteps; ++k) {
        const double dx = u - arch.x[k], dy = v - arch.y[k], d2 = dx * dx + dy * dy;
        if (d2 < least) least = d2, nearest = k;
      }
      const double best = std::hypot(u - arch.x[nearest], v - arch.y[nearest]);
      if (best > kWidest) continue;
      const double t = static_cast<double>(nearest + 1) / kSteps;
      const double half = 0.085 * std::sin(pi * std::clamp(t, 0.05, 0.98)) + 0.01;
      const bool comb = std::fmod(t * 17 + i * 0.37, 1.0) < 0.72 || best < 0.012;
      if (best < half && comb) return shade(0.5 + 0.4 * t * arch.tone);
    }
    return {};
  }

 private:
  static constexpr int kFronds = 9, kSteps = 24;
  static constexpr double kWidest = 0.0951;
  struct Arch {
    double x[kSteps], y[kSteps];
    double x0, x1, y0, y1;  ///< bounds of its frond
    double tone;
  };
  Arch arches_[kFronds];
};

/// Leaves on a twig.
class Leaves {
 public:
  Leaves() {
    for (int i = 0; i < kLeaves; ++i) {
      const double side = i % 2 ? 1 : -1, angle = side * (0.5 + 0.9 * draw(4, i, 0));
      leaves_[i] = {std::sin(angle),
                    std::cos(angle),
                    0.22 + 0.14 * draw(4, i, 1),
                    0.18 * (draw(4, i, 2) - 0.3) * side,
                    0.04 + 0.85 * i / 26.0,
                    0.62 + 0.33 * draw(4, i, 3)};
    }
  }
  Ink operator()(double u, double v) const {
    for (int i = kLeaves - 1; i >= 0; --i) {
      const Leaf& l = leaves_[i];
      const double dx = u - 0.5 - l.spread, dy = v - l.foot;
      const double along = (dx * l.sine + dy * l.cosine) / l.length;
      const double across = (dx * l.cosine - dy * l.sine) / l.length;
      if (along < 0 || along > 1 || std::abs(across) > 0.301) continue;
      const double half = 0.30 * std::sin(pi * std::pow(along, 0.8)) * (1 - 0.15 * along);
      if (std::abs(across) > half) continue;
      const double vein = std::abs(across) < 0.02 ? 0.85 : 1.0;
      return shade(vein * l.tone);
    }
    if (std::abs(u - 0.5 - 0.05 * std::sin(v * 5)) < 0.008 && v < 0.9) return {true, {0.5, 0.42, 0.4}};
    return {};
  }

 private:
  static constexpr int kLeaves = 26;
  struct Leaf {
    double sine, cosine, length, spread, foot, tone;
  };
  Leaf leaves_[kLeaves];
};

/// One dry leaf, lobed, with veins.
Ink leaf(double u, double v) {
  const double along = v, across = std::abs(u - 0.5);
  if (along < 0.10) return across < 0.015 ? shade(0.6) : Ink{};
  const double t = (along - 0.10) / 0.9;
  const double half =
      0.46 * std::pow(std::sin(pi * std::pow(t, 0.75)), 0.8) * (0.84 + 0.16 * std::cos(t * 22));
  if (across > half) return {};
  const bool vein = across < 0.014 || std::fmod(t * 7 + 10 - across * 4, 1.0) < 0.08;
  const double blotch = 0.85 + 0.12 * std::sin(u * 17 + 3 * std::sin(v * 11)) * std::sin(v * 13);
  const double s = (vein ? 0.70 : 0.88) * blotch;
  return {true, {s, s * (0.93 + 0.07 * blotch), s * 0.92}};
}

/// A flower's head from above: petals around a yellow middle.
Ink head(double u, double v) {
  const double x = 2 * u - 1, y = 2 * v - 1, r = std::hypot(x, y), a = std::atan2(y, x);
  if (r < 0.26) return {true, {0.9, 0.72, 0.10}};
  const double petal = std::abs(std::cos(a * 6));
  if (r > 0.55 + 0.42 * std::pow(petal, 0.45)) return {};
  return shade(0.82 + 0.15 * petal);
}

}  // namespace

const CardPicture& card_picture(Card card) {
  static const auto all = [] {
    const std::array<std::function<CardPicture()>, 7> painters = {
        [] { return paint(8, 64, blade); },       [] { return paint(128, 128, Tuft()); },
        [] { return paint(128, 256, Frond()); },  [] { return paint(128, 128, FernSide()); },
        [] { return paint(128, 128, Leaves()); }, [] { return paint(64, 128, leaf); },
        [] { return paint(64, 64, head); }};
    std::array<CardPicture, painters.size()> pictures;
    render::make_in_parallel(pictures.size(), [&](std::size_t i) { pictures[i] = painters[i](); });
    return pictures;
  }();
  return all[static_cast<std::size_t>(card)];
}

}  // namespace rigor::nature
