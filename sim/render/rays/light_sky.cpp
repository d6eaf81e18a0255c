#include "sim/render/rays/light_sky.h"

#include <cmath>
#include <numbers>

namespace rigor::render::light {
namespace {

using std::numbers::pi;
/// Cells along a side of the table of irradiance. Even: the octahedron's edges lie on its places.
constexpr int kSide = 32;
/// The sky is gathered into this many patches before it is integrated.
constexpr int kPatchColumns = 48, kPatchRows = 12;

/// Arc tangent of y / x in the right quadrant, within 2e-6 rad (Hastings 1955, sheet 13, on 0 to 1).
float angle_of(float y, float x) noexcept {
  const float ax = std::abs(x), ay = std::abs(y), most = std::max(ax, ay);
  if (!(most > 0)) return 0;
  const float a = std::min(ax, ay) / most, s = a * a;
  float r = 0.0028662257F;
  r = r * s - 0.0161657367F;
  r = r * s + 0.0429096138F;
  r = r * s - 0.0752896400F;
  r = r * s + 0.1065626393F;
  r = r * s - 0.1420889944F;
  r = r * s + 0.1999355085F;
  r = r * s - 0.3333314528F;
  r = a + a * s * r;
  if (ay > ax) r = 0.5F * std::numbers::pi_v<float> - r;
  if (x < 0) r = std::numbers::pi_v<float> - r;
  return std::copysign(r, y);
}

Vec3 octahedral(int i, int j) {
  float x = 2.0F * static_cast<float>(i) / kSide - 1, y = 2.0F * static_cast<float>(j) / kSide - 1;
  const float z = 1 - std::abs(x) - std::abs(y);
  if (z < 0) {
    const float turned = (1 - std::abs(y)) * std::copysign(1.0F, x);
    y = (1 - std::abs(x)) * std::copysign(1.0F, y);
    x = turned;
  }
  return unit({x, y, z}, {0, 0, 1});
}

}  // namespace

SkyTables::SkyTables(const SkyMap* map, const std::array<int, 4>& bands) {
  if (map != nullptr && map->width > 0 && map->height > 0 &&
      map->radiance.size() >= static_cast<std::size_t>(map->width) * static_cast<std::size_t>(map->height)) {
    width_ = map->width;
    height_ = map->height;
    texels_.resize(static_cast<std::size_t>(width_ + 1) * static_cast<std::size_t>(height_));
    for (int j = 0; j < height_; ++j)
      for (int i = 0; i <= width_; ++i) {
        Bands4 l =
            not_negative(pick(map->radiance[static_cast<std::size_t>(j * width_ + i % width_)], bands));
        for (int b = 0; b < 4; ++b) l[b] = std::isfinite(l[b]) ? l[b] : 0.0F;
        texels_[static_cast<std::size_t>(j * (width_ + 1) + i)] = l;
      }
  }
  integrate();
}

void SkyTables::integrate() {
  irradiance_.assign(static_cast<std::size_t>((kSide + 1) * (kSide + 1)), Bands4{});
  if (width_ == 0) return;
  // Integral of radiance times direction over each patch: what a plane gets of a patch that it sees wholly is
  // its normal times that, exactly.
  struct DirectedLight {
    Bands4 x{}, y{}, z{};
  };
  std::vector<DirectedLight> patches(static_cast<std::size_t>(kPatchColumns * kPatchRows));
  const int fine_rows = std::max(height_, kPatchRows), fine_columns = std::max(width_, kPatchColumns);
  for (int j = 0; j < fine_rows; ++j) {
    const double low = j * 0.5 * pi / fine_rows, high = (j + 1) * 0.5 * pi / fine_rows;
    const double sin_low = std::sin(low), sin_high = std::sin(high);
    // Over the row: of cos² and of sin cos of the elevation.
    const double across = 0.5 * (high - low) + 0.25 * (std::sin(2 * high) - std::sin(2 * low));
    const double up = 0.5 * (sin_high * sin_high - sin_low * sin_low);
    for (int i = 0; i < fine_columns; ++i) {
      const double a0 = i * 2 * pi / fine_columns, a1 = (i + 1) * 2 * pi / fine_columns;
      const Bands4 l = texels_[static_cast<std::size_t>(j * height_ / fine_rows * (width_ + 1) +
                                                        i * width_ / fine_columns)];
      DirectedLight& p = patches[static_cast<std::size_t>(j * kPatchRows / fine_rows * kPatchColumns +
                                                          i * kPatchColumns / fine_columns)];
      p.x += l * static_cast<float>(across * (std::cos(a0) - std::cos(a1)));
      p.y += l * static_cast<float>(across * (std::sin(a1) - std::sin(a0)));
      p.z += l * static_cast<float>(up * (a1 - a0));
    }
  }
  for (int j = 0; j <= kSide; ++j)
    for (int i = 0; i <= kSide; ++i) {
      const Vec3 n = octahedral(i, j);
      Bands4 sum{};
      for (const DirectedLight& p : patches) sum += not_negative(p.x * n.x + p.y * n.y + p.z * n.z);
      irradiance_[static_cast<std::size_t>(j * (kSide + 1) + i)] = sum;
    }
}

Bands4 SkyTables::radiance(Vec3 d) const noexcept {
  if (width_ == 0) return Bands4{};
  const float w = static_cast<float>(width_), h = static_cast<float>(height_);
  float u = angle_of(d.x, d.y) * (0.5F * std::numbers::inv_pi_v<float> * w) - 0.5F;
  if (u < 0) u += w;
  const float elevation = angle_of(std::max(d.z, 0.0F), std::sqrt(d.x * d.x + d.y * d.y));
  const float v = std::clamp(elevation * (2.0F * std::numbers::inv_pi_v<float> * h) - 0.5F, 0.0F, h - 1.0F);
  // Not a number: any texel will do.
  const int i = std::clamp(static_cast<int>(u), 0, width_ - 1);
  const int j = std::clamp(static_cast<int>(v), 0, height_ - 1), above = std::min(j + 1, height_ - 1);
  const float fu = u - static_cast<float>(i), fv = v - static_cast<float>(j);
  const Bands4* low = &texels_[static_cast<std::size_t>(j * (width_ + 1) + i)];
  const Bands4* high = &texels_[static_cast<std::size_t>(above * (width_ + 1) + i)];
  return mix(mix(low[0], low[1], fu), mix(high[0], high[1], fu), fv);
}

Bands4 SkyTables::irradiance(Vec3 n) const noexcept {
  const float sum = std::abs(n.x) + std::abs(n.y) + std::abs(n.z);
  const float k = sum > 0 ? 1.0F / sum : 0.0F;
  float x = n.x * k, y = n.y * k;
  if (n.z < 0) {
    const float turned = (1 - std::abs(y)) * std::copysign(1.0F, x);
    y = (1 - std::abs(x)) * std::copysign(1.0F, y);
    x = turned;
  }
  const float u = std::clamp(0.5F * kSide * (x + 1), 0.0F, static_cast<float>(kSide));
  const float v = std::clamp(0.5F * kSide * (y + 1), 0.0F, static_cast<float>(kSide));
  const int i = std::clamp(static_cast<int>(u), 0, kSide - 1),
            j = std::clamp(static_cast<int>(v), 0, kSide - 1);
  const float fu = u - static_cast<float>(i), fv = v - static_cast<float>(j);
  const Bands4* low = &irradiance_[static_cast<std::size_t>(j * (kSide + 1) + i)];
  const Bands4* high = low + kSide + 1;
  return mix(mix(low[0], low[1], fu), mix(high[0], high[1], fu), fv);
}

}  // namespace rigor::render::light
