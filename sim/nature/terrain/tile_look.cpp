#include <array>
#include <bit>
#include <optional>
#include <span>
#include <string_view>

#include "sensor-hal/models/wide.h"
#include "sim/nature/terrain/tile.h"
#include "sim/render/content/surface_library.h"
#include "sim/render/content/texels.h"

namespace rigor::nature {
namespace {

using render::Spectrum;

/// Reflectance along a row of texels, band by band.
using RowOfTexels = std::array<std::array<float, kTileTexels>, std::tuple_size_v<Spectrum>>;

/// What a cover is made of: a first surface, and two that take a share of its area in patches; `tone` and
/// `grain` are the relative standard deviations of brightness over metres and over centimetres.
struct Recipe {
  std::string_view first, second, third;
  double second_share, third_share;
  double tone, grain;
  bool overgrown;  ///< gives way to soil and rock where it is steep
};
constexpr Recipe kRecipes[] = {
    {"soil", "gravel", "soil", 0.2, 0, 0.15, 0.15, false},           // water: its bed
    {"grass", "dry_grass", "soil", 0.22, 0.08, 0.16, 0.36, true},    // grass
    {"grass", "dry_grass", "soil", 0.38, 0.04, 0.20, 0.38, true},    // meadow
    {"grass", "leaf_litter", "soil", 0.35, 0.10, 0.18, 0.38, true},  // shrub
    {"leaf_litter", "soil", "grass", 0.30, 0.16, 0.18, 0.42, true},  // forest_floor
    {"leaf_litter", "grass", "soil", 0.40, 0.12, 0.18, 0.40, true},  // fern
    {"soil", "gravel", "leaf_litter", 0.10, 0.06, 0.14, 0.28, true},
    {"rock", "gravel", "soil", 0.18, 0.08, 0.18, 0.24, false},
    {"gravel", "soil", "sand", 0.12, 0.10, 0.10, 0.36, false},
    {"sand", "gravel", "sand", 0.06, 0, 0.08, 0.08, false},
    {"snow", "snow", "snow", 0, 0, 0.02, 0.015, false},
    {"asphalt", "asphalt", "gravel", 0, 0.01, 0.08, 0.14, false},
    {"concrete", "concrete", "soil", 0, 0.02, 0.07, 0.06, false},
    {"crop", "soil", "dry_grass", 0.22, 0.08, 0.10, 0.24, true},
    {"grass", "soil", "dry_grass", 0.28, 0.20, 0.18, 0.24, false},    // wetland
    {"concrete", "asphalt", "grass", 0.35, 0.18, 0.15, 0.14, false},  // built_up
    {"grass", "dry_grass", "soil", 0.22, 0.08, 0.16, 0.24, true},     // nobody says what it is
};
static_assert(std::size(kRecipes) == kBareGround + 1);
static_assert(std::size(world::types::kCoverWords) == kBareGround);

/// Surfaces of the library, and two that only the ground needs.
Spectrum spectrum(std::string_view name) {
  // Senescent grass and a closed cereal canopy, after the shapes of the USGS and ECOSTRESS libraries.
  if (name == "dry_grass") return {0.20F, 0.155F, 0.095F, 0.40F, 0.43F, 0.36F};
  if (name == "crop") return {0.07F, 0.105F, 0.045F, 0.44F, 0.46F, 0.24F};
  return render::SurfaceLibrary::builtin().get(name)->reflectance;
}

struct Mixture {
  std::array<Spectrum, 3> part;
};
const std::array<Mixture, std::size(kRecipes)>& mixtures() {
  static const auto all = [] {
    std::array<Mixture, std::size(kRecipes)> m;
    for (std::size_t i = 0; i < m.size(); ++i) {
      m[i].part = {spectrum(kRecipes[i].first), spectrum(kRecipes[i].second), spectrum(kRecipes[i].third)};
    }
    return m;
  }();
  return all;
}

/// e^x within a few of its last bits; x from -700 to 700.
RIGOR_WIDE_STEP double exp_of(double x) {
  constexpr double kWhole = 0x1.8p52;  // adding it rounds to whole numbers
  const double shifted = x * 1.4426950408889634 + kWhole, whole = shifted - kWhole;
  const double r = (x - whole * 0x1.62e42fee00000p-1) - whole * 0x1.a39ef35793c76p-33;  // ln 2 in two parts
  double sum = 1.0 / 479001600;
  sum = sum * r + 1.0 / 39916800;
  sum = sum * r + 1.0 / 3628800;
  sum = sum * r + 1.0 / 362880;
  sum = sum * r + 1.0 / 40320;
  sum = sum * r + 1.0 / 5040;
  sum = sum * r + 1.0 / 720;
  sum = sum * r + 1.0 / 120;
  sum = sum * r + 1.0 / 24;
  sum = sum * r + 1.0 / 6;
  sum = sum * r + 0.5;
  sum = sum * r + 1;
  sum = sum * r + 1;
  const std::uint64_t power = std::bit_cast<std::uint64_t>(shifted) - std::bit_cast<std::uint64_t>(kWhole);
  return sum * std::bit_cast<double>((power + 1023) << 52);
}

/// Share of a patchy surface: a soft step of noise. Noise is a few standard deviations at most, and widths
/// are not small: no exponent is beyond 100.
RIGOR_WIDE_STEP double soft_step(double noise, double threshold, double width) {
  return 1 / (1 + exp_of((threshold - noise) / width));
}
/// A factor of reflectance.
RIGOR_WIDE_STEP double brightness(double tone, double grain, float tone_noise, float grain_noise) {
  const double b = 1 + tone * static_cast<double>(tone_noise) + grain * static_cast<double>(grain_noise);
  return b > 0.25 ? b : 0.25;
}

/// Share of a patchy surface at a place whose noise is n (standard deviation 1 in full): a soft threshold
/// that keeps the share on average however much of the noise is missing.
struct PatchShare {
  bool any = false;
  double threshold = 0;
  PatchShare() = default;
  explicit PatchShare(double share)
      : any(share > 0), threshold(share > 0 ? std::log((1 - share) / share) / 1.7 : 0) {}
  static double width(double missing) { return std::max(0.12, missing / 1.7); }
  [[nodiscard]] double at(double n, double width) const { return any ? soft_step(n, threshold, width) : 0; }
};
struct PatchShares {
  PatchShare second, third;
};
const std::array<PatchShares, std::size(kRecipes)>& patch_shares() {
  static const auto all = [] {
    std::array<PatchShares, std::size(kRecipes)> p;
    for (std::size_t i = 0; i < p.size(); ++i)
      p[i] = {PatchShare(kRecipes[i].second_share), PatchShare(kRecipes[i].third_share)};
    return p;
  }();
  return all;
}

RIGOR_WIDE void shares_along(const float* noise, double threshold, double width, int n, float* share) {
  for (int i = 0; i < n; ++i)
    share[i] = static_cast<float>(soft_step(static_cast<double>(noise[i]), threshold, width));
}
RIGOR_WIDE void brightness_along(const float* tones, const float* grains, double tone, double grain, int n,
                                 double* out) {
  for (int i = 0; i < n; ++i) out[i] = brightness(tone, grain, tones[i], grains[i]);
}

/// Of one band of a cover along a row, as TilePainter::ingredients() has it.
struct BandOfRow {
  float part[3];
  const float* share[2];  ///< of the second and third part; null: none
  const double* brightness;
};
RIGOR_WIDE void reflect(const BandOfRow& band, int n, float* out) {
  const float* const second = band.share[0];
  const float* const third = band.share[1];
  for (int i = 0; i < n; ++i) out[i] = band.part[0];
  if (second)
    for (int i = 0; i < n; ++i) out[i] += (band.part[1] - out[i]) * second[i];
  if (third)
    for (int i = 0; i < n; ++i) out[i] += (band.part[2] - out[i]) * third[i];
  for (int i = 0; i < n; ++i) out[i] = std::min(0.98F, static_cast<float>(out[i] * band.brightness[i]));
}

double smoothstep(double low, double high, double v) {
  const double t = std::clamp((v - low) / (high - low), 0.0, 1.0);
  return t * t * (3 - 2 * t);
}

/// A channel of noise over the texels of a tile, divided by its standard deviation.
struct Channel {
  Channel(const FractalNoise& noise, const RasterPlaces& places) : raster(noise_over(noise, places)) {
    const double sigma = noise.sigma();
    for (float& v : raster.values) v = static_cast<float>(v / sigma);
    missing = raster.missing_sigma / sigma;
  }
  NoiseRaster raster;
  double missing;
};

class TilePainter {
 public:
  TilePainter(const HeightTree& tree, const RasterPlaces& places)
      : slopes_(kSlopes * kSlopes),
        tree_(tree),
        places_(places),
        tone_({.stream = 1, .longest = 7, .shortest = 0, .gain = 0.75}, places),
        patch_({.stream = 2, .longest = 4, .shortest = -7, .gain = 0.85}, places),
        patch2_({.stream = 3, .longest = 2, .shortest = -7, .gain = 0.9}, places),
        grain_({.stream = 4, .longest = -2, .shortest = -8, .gain = 1.15}, places) {
    patch_width_ = PatchShare::width(patch_.missing);
    patch2_width_ = PatchShare::width(patch2_.missing);
    const double last = places.n - 1;
    one_cover_ = tree.ground().one_cover(
        {places.x0, places.y0 - places.step * last, places.x0 + places.step * last, places.y0});
    const auto& f = tree.grid().frame;
    const double step = places.step * (places.n - 1) / (kSlopes - 1);
    for (int j = 0; j < kSlopes; ++j) {
      for (int i = 0; i < kSlopes; ++i) {
        const double slope =
            grid_slope(tree.grid(), f.u(places.x0 + i * step), f.v(places.y0 - j * step)).norm();
        slopes_[static_cast<std::size_t>(j) * kSlopes + i] = std::isfinite(slope) ? slope : 0;
        steep_ = steep_ || slope > 0.99 * kSteep;
      }
    }
  }

  /// All texels of a row.
  void row(int row, RowOfTexels& out) {
    if (one_cover_) return part_of_row(*one_cover_, {row, 0, places_.n}, out);
    const double y = places_.y0 - places_.step * row;
    for (int begin = 0; begin < places_.n; begin += kTogether) {
      const int end = std::min(begin + kTogether, places_.n);
      const Rect texels{places_.x0 + places_.step * begin, y, places_.x0 + places_.step * (end - 1), y};
      if (const auto one = tree_.ground().one_cover(texels))
        part_of_row(*one, {row, begin, end}, out);
      else
        for (int column = begin; column < end; ++column) put(at(column, row), column, out);
    }
  }

 private:
  /// So many texels of a row are looked at together.
  static constexpr int kTogether = 16;
  struct RowPart {
    int row, begin, end;
  };

  /// Where it is all of one cover.
  void part_of_row(std::uint8_t which, const RowPart& of, RowOfTexels& row) {
    const Recipe& recipe = kRecipes[which];
    const PatchShares& shares = patch_shares()[which];
    const auto& part = mixtures()[which].part;
    const int n = of.end - of.begin;
    const std::size_t first = static_cast<std::size_t>(of.row) * static_cast<std::size_t>(places_.n) +
                              static_cast<std::size_t>(of.begin);
    float second[kTileTexels], third[kTileTexels];
    double brightness[kTileTexels];
    brightness_along(&tone_.raster.values[first], &grain_.raster.values[first], recipe.tone, recipe.grain, n,
                     brightness);
    if (shares.second.any)
      shares_along(&patch_.raster.values[first], shares.second.threshold, patch_width_, n, second);
    if (shares.third.any)
      shares_along(&patch2_.raster.values[first], shares.third.threshold, patch2_width_, n, third);
    for (std::size_t b = 0; b < part[0].size(); ++b)
      reflect({{part[0][b], part[1][b], part[2][b]},
               {shares.second.any ? second : nullptr, shares.third.any ? third : nullptr},
               brightness},
              n, &row[b][static_cast<std::size_t>(of.begin)]);
    if (!recipe.overgrown || !steep_) return;
    for (int column = of.begin; column < of.end; ++column) {
      const double slope = slope_at(column, of.row);
      texel_ = first + static_cast<std::size_t>(column - of.begin);
      if (slope > kSteep) put(cover(which, slope), column, row);
    }
  }

  static void put(const Spectrum& s, int column, RowOfTexels& row) {
    for (std::size_t b = 0; b < s.size(); ++b) row[b][static_cast<std::size_t>(column)] = s[b];
  }

  Spectrum at(int column, int row) {
    texel_ = static_cast<std::size_t>(row) * places_.n + column;
    const double x = places_.x0 + places_.step * column, y = places_.y0 - places_.step * row;
    const CoverMix mix = tree_.ground().cover_mix(x, y, [&](std::uint8_t cover, double spacing) {
      auto& channel = borders_[cover];
      if (!channel) channel.emplace(border_noise(cover, spacing), places_);
      return channel->raster.values[texel_];
    });
    Spectrum sum{};
    const double slope = slope_at(column, row);
    for (int i = 0; i < mix.count; ++i) {
      if (mix.weight[i] < 1e-3F) continue;
      const Spectrum one = cover(mix.cover[i], slope);
      for (std::size_t b = 0; b < sum.size(); ++b) sum[b] += mix.weight[i] * one[b];
    }
    return sum;
  }

  /// Steepness at so many places along a side, bilinear between them.
  static constexpr int kSlopes = 33;
  /// From here on what grows gives way.
  static constexpr double kSteep = 0.3;
  [[nodiscard]] double slope_at(int column, int row) const {
    const double scale = (kSlopes - 1.0) / (places_.n - 1), u = column * scale, v = row * scale;
    const int i = std::min(static_cast<int>(u), kSlopes - 2), j = std::min(static_cast<int>(v), kSlopes - 2);
    const double* a = &slopes_[static_cast<std::size_t>(j) * kSlopes + i];
    const double fu = u - i, fv = v - j;
    return (a[0] * (1 - fu) + a[1] * fu) * (1 - fv) + (a[kSlopes] * (1 - fu) + a[kSlopes + 1] * fu) * fv;
  }
  [[nodiscard]] Spectrum cover(std::uint8_t which, double slope) const {
    const Recipe& recipe = kRecipes[which];
    Spectrum s = ingredients(which);
    if (recipe.overgrown && slope > kSteep) {
      const double rough = slope + 0.12 * patch_.raster.values[texel_];
      const double soil = smoothstep(0.55, 0.95, rough), rock = smoothstep(0.8, 1.15, rough);
      static const auto soil_cover = cover_index("soil"), rock_cover = cover_index("rock");
      if (soil > 0) s = blend(s, ingredients(soil_cover), soil * 0.8);
      if (rock > 0) s = blend(s, ingredients(rock_cover), rock);
    }
    return s;
  }

  [[nodiscard]] Spectrum ingredients(std::uint8_t which) const {
    const Recipe& recipe = kRecipes[which];
    const auto& part = mixtures()[which].part;
    Spectrum s = part[0];
    const PatchShares& shares = patch_shares()[which];
    const double second = shares.second.at(patch_.raster.values[texel_], patch_width_);
    if (second > 0) s = blend(s, part[1], second);
    const double third = shares.third.at(patch2_.raster.values[texel_], patch2_width_);
    if (third > 0) s = blend(s, part[2], third);
    const double brightness = brightness_of(recipe, texel_);
    for (float& v : s) v = std::min(0.98F, static_cast<float>(v * brightness));
    return s;
  }

  [[nodiscard]] double brightness_of(const Recipe& recipe, std::size_t texel) const {
    return brightness(recipe.tone, recipe.grain, tone_.raster.values[texel], grain_.raster.values[texel]);
  }

  static Spectrum blend(const Spectrum& a, const Spectrum& b, double t) {
    Spectrum s;
    for (std::size_t i = 0; i < s.size(); ++i) s[i] = a[i] + (b[i] - a[i]) * static_cast<float>(t);
    return s;
  }

  std::vector<double> slopes_;
  const HeightTree& tree_;
  RasterPlaces places_;
  Channel tone_, patch_, patch2_, grain_;
  double patch_width_ = 0, patch2_width_ = 0;
  std::optional<std::uint8_t> one_cover_;  ///< of the whole tile
  std::array<std::optional<Channel>, kBareGround> borders_;
  bool steep_ = false;  ///< somewhere
  std::size_t texel_ = 0;
};

/// Bilinear; false where no picture is.
bool picture_at(const Ground& ground, double x, double y, std::array<std::uint8_t, 3>& out) {
  for (const auto& p : ground.pictures) {
    if (!p.frame.cells().contains(x, y)) continue;
    const double u = std::clamp(p.frame.u(x), 0.0, p.frame.columns - 1.0);
    const double v = std::clamp(p.frame.v(y), 0.0, p.frame.rows - 1.0);
    const int c = static_cast<int>(u), r = static_cast<int>(v);
    const int c1 = std::min(c + 1, p.frame.columns - 1), r1 = std::min(r + 1, p.frame.rows - 1);
    const double fu = u - c, fv = v - r;
    const auto mixed = [&](std::uint8_t Rgb8::*k) {
      const double top = p.at(c, r).*k * (1 - fu) + p.at(c1, r).*k * fu;
      const double bottom = p.at(c, r1).*k * (1 - fu) + p.at(c1, r1).*k * fu;
      return static_cast<std::uint8_t>(std::lround(top * (1 - fv) + bottom * fv));
    };
    out = {mixed(&Rgb8::r), mixed(&Rgb8::g), mixed(&Rgb8::b)};
    return true;
  }
  return false;
}

}  // namespace

std::shared_ptr<render::Surface> tile_surface(const HeightTree& tree, const TreeNode& node,
                                              bool plain_imagery) {
  const auto& f = tree.grid().frame;
  const double size = std::ldexp(1.0, node.m), x0 = f.x(static_cast<double>(node.i) * size),
               y0 = f.y(static_cast<double>(node.j) * size);
  const RasterPlaces places{x0, y0, size * f.spacing_m / (kTileTexels - 1), kTileTexels};
  TilePainter painter(tree, places);
  const auto texture = [] {
    auto t = std::make_shared<render::Texture>();
    t->width = t->height = kTileTexels;
    t->repeat = false;
    t->rgba.resize(static_cast<std::size_t>(kTileTexels) * kTileTexels * 4);
    return t;
  };
  auto colour = texture(), infrared = texture();
  RowOfTexels along{};
  const render::SrgbBytes& bytes = render::srgb_bytes();
  for (int row = 0; row < kTileTexels; ++row) {
    painter.row(row, along);
    const std::size_t first = static_cast<std::size_t>(row) * kTileTexels * 4;
    const auto paint = [&](std::uint8_t* rgba, std::size_t first_band) {
      for (std::size_t i = 0; i < kTileTexels; ++i, rgba += 4) {
        for (std::size_t k = 0; k < 3; ++k) rgba[k] = bytes.of(along[first_band + k][i]);
        rgba[3] = 255;
      }
    };
    paint(&colour->rgba[first], 0);
    paint(&infrared->rgba[first], 3);
    if (!plain_imagery) continue;
    for (std::size_t i = 0; i < kTileTexels; ++i) {
      std::array<std::uint8_t, 3> rgb{};
      if (picture_at(tree.ground(), x0 + places.step * static_cast<double>(i), y0 - places.step * row, rgb))
        std::copy(rgb.begin(), rgb.end(), &colour->rgba[first + 4 * i]);
    }
  }
  auto surface = std::make_shared<render::Surface>();
  surface->name = "ground";
  surface->reflectance.fill(1.0F);
  surface->colour_map = std::move(colour);
  surface->near_infrared_map = std::move(infrared);
  surface->porosity = 0.8F;
  return surface;
}

}  // namespace rigor::nature
