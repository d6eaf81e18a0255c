#include "sim/render/rays/light_gather.h"

#include <algorithm>
#include <bit>

namespace rigor::render::light {
namespace {

/// Sides of cells are powers of two: 2^kSmallest m to 2^kLargest m.
constexpr int kSmallest = -5, kLargest = 14;
/// A level answers where its cells hold at least this weight of paths.
constexpr float kEnough = 48;

/// Level and cell, never 0. Cells beyond ±2^19 share one.
std::uint64_t key_of(int level, int x, int y, int z) noexcept {
  const auto part = [](int v) {
    return static_cast<std::uint64_t>(std::clamp(v, -(1 << 18), (1 << 18) - 1) + (1 << 18));
  };
  return static_cast<std::uint64_t>(level - kSmallest + 1) << 57U | part(x) << 38U | part(y) << 19U | part(z);
}

std::size_t hash_of(std::uint64_t key) noexcept {
  key ^= key >> 31U;
  key *= 0x9E3779B97F4A7C15ULL;
  return static_cast<std::size_t>(key ^ key >> 29U);
}

float scale_of(int level) noexcept {
  return std::bit_cast<float>(static_cast<std::uint32_t>(127 - level) << 23U);
}

/// Cells of places without bounds: what floats can count.
int floor_of(float v) noexcept {
  const float bounded = v > -1e6F ? std::min(v, 1e6F) : -1e6F;
  const int whole = static_cast<int>(bounded);
  return static_cast<float>(whole) > bounded ? whole - 1 : whole;
}

}  // namespace

GatheredLight::Parts GatheredLight::parts_of(Vec3 n) noexcept {
  return {{n.x * n.x, n.y * n.y, n.z * n.z}, {n.x < 0 ? 1 : 0, n.y < 0 ? 3 : 2, n.z < 0 ? 5 : 4}};
}

int GatheredLight::level_of(float range_m) const noexcept {
  // The logarithm to base 2, rounded: the exponent, and one more from the square root of 2 on.
  const auto bits = std::bit_cast<std::uint32_t>(std::max(range_m * cell_rad_, 1e-3F));
  constexpr std::uint32_t kFraction = 0x7FFFFF, kRootOf2 = 0x3504F3;
  const int level = static_cast<int>(bits >> 23U) - 127 + ((bits & kFraction) >= kRootOf2 ? 1 : 0);
  return std::clamp(level, kSmallest, kLargest - kLevels + 1);
}

GatheredLight::Cell& GatheredLight::cell(std::uint64_t key) {
  if (2 * (used_ + 1) > cells_.size()) {
    std::vector<Cell> old(std::max<std::size_t>(1024, 2 * cells_.size()));
    old.swap(cells_);
    for (const Cell& c : old) {
      if (c.key == 0) continue;
      std::size_t at = hash_of(c.key) & (cells_.size() - 1);
      while (cells_[at].key != 0) at = (at + 1) & (cells_.size() - 1);
      cells_[at] = c;
    }
  }
  std::size_t at = hash_of(key) & (cells_.size() - 1);
  while (cells_[at].key != 0 && cells_[at].key != key) at = (at + 1) & (cells_.size() - 1);
  if (cells_[at].key == 0) {
    cells_[at].key = key;
    ++used_;
  }
  return cells_[at];
}

const GatheredLight::Cell* GatheredLight::find(std::uint64_t key) const noexcept {
  std::size_t at = hash_of(key) & (cells_.size() - 1);
  while (cells_[at].key != 0 && cells_[at].key != key) at = (at + 1) & (cells_.size() - 1);
  return cells_[at].key == 0 ? nullptr : &cells_[at];
}

void GatheredLight::add(const Gathered& gathered) {
  for (const GatheredPath& p : gathered.paths) {
    const Bands4 open = p.open * p.part_of_rays;
    const float free = p.free ? p.part_of_rays : 0.0F;
    add(p.place, p.normal, p.range_m,
        Sum{p.scattered * p.part_of_paths, open, p.free ? open : Bands4{},
            Bands4{p.part_of_paths, free, 1, p.part_of_rays}});
  }
  for (const GatheredSky& s : gathered.skies) {
    const float free = static_cast<float>(std::popcount(s.free)) * s.part_of_rays,
                all = static_cast<float>(s.rays) * s.part_of_rays;
    add(s.place, s.normal, s.range_m,
        Sum{Bands4{}, s.open * s.part_of_rays, s.sky * s.part_of_rays, Bands4{0, free, 0, all}});
  }
}

void GatheredLight::add(Vec3 place, Vec3 normal, float range_m, const Sum& of) {
  if (!finite(place) || !finite(normal)) return;
  const Parts parts = parts_of(normal);
  const auto count = [&](Sum(&axis)[6]) {
    for (int k = 0; k < 3; ++k) {
      const float w = parts.weight[k];
      Sum& s = axis[parts.axis[k]];
      s.scattered += of.scattered * w;
      s.open += of.open * w;
      s.sky += of.sky * w;
      s.weight += of.weight * w;
    }
  };
  count(everywhere_);
  const int finest = level_of(range_m);
  for (int level = finest; level < finest + kLevels; ++level) {
    const float scale = scale_of(level);
    count(cell(key_of(level, floor_of(place.x * scale), floor_of(place.y * scale), floor_of(place.z * scale)))
              .axis);
  }
}

void GatheredLight::About::enter(int k) noexcept {
  const int level = finest_ + k;
  const Vec3 at = place_ * scale_of(level) - Vec3{0.5F, 0.5F, 0.5F};
  const int x = floor_of(at.x), y = floor_of(at.y), z = floor_of(at.z);
  const auto part = [](float v, int low) { return std::clamp(v - static_cast<float>(low), 0.0F, 1.0F); };
  const float fx = part(at.x, x), fy = part(at.y, y), fz = part(at.z, z);
  const std::uint64_t key = key_of(level, x, y, z);
  Found::Eight& eight = found_.eights_[hash_of(key) % found_.eights_.size()];
  if (eight.key != key) {
    eight.key = key;
    for (int i = 0; i < 8; ++i)
      eight.cells[static_cast<std::size_t>(i)] =
          light_.find(key_of(level, x + (i & 1), y + (i >> 1 & 1), z + (i >> 2)));
  }
  Level& l = levels_[k];
  l.cells = l.summed = 0;
  for (int i = 0; i < 8; ++i) {
    const Cell* const c = eight.cells[static_cast<std::size_t>(i)];
    if (c == nullptr) continue;
    l.cell[l.cells] = c;
    l.share[l.cells++] =
        ((i & 1) != 0 ? fx : 1 - fx) * ((i >> 1 & 1) != 0 ? fy : 1 - fy) * (i >> 2 != 0 ? fz : 1 - fz);
  }
  entered_ |= 1U << static_cast<unsigned>(k);
}

const GatheredLight::Sum& GatheredLight::About::sum(Level& l, int axis) noexcept {
  if ((l.summed >> static_cast<unsigned>(axis) & 1U) == 0) {
    Bands4 scattered{}, open{}, sky{}, weight{};
    for (unsigned i = 0; i < l.cells; ++i) {
      const Sum& s = l.cell[i]->axis[axis];
      const float share = l.share[i];
      scattered += s.scattered * share;
      open += s.open * share;
      sky += s.sky * share;
      weight += s.weight * Bands4{share, share, 1, share};
    }
    l.axis[axis] = {scattered, open, sky, weight};
    l.summed |= 1U << static_cast<unsigned>(axis);
  }
  return l.axis[axis];
}

GatheredLight::Mean GatheredLight::mean_of(const Sum& x, const Sum& y, const Sum& z,
                                           const Parts& parts) noexcept {
  const Sum* const axis[3] = {&x, &y, &z};
  Mean out;
  for (int a = 0; a < 3; ++a) {
    const float all = axis[a]->weight[0], part = parts.weight[a];
    if (!(all > 1e-3F * part) || !(part > 0)) continue;
    const float of_rays = part / axis[a]->weight[3];
    out.scattered += axis[a]->scattered * (part / all);
    out.open += axis[a]->open * of_rays;
    out.sky += axis[a]->sky * of_rays;
    out.free += axis[a]->weight[1] * of_rays;
    out.known += part;
  }
  return out;
}

Bands4 GatheredLight::About::irradiance(Vec3 normal, Bands4 open) noexcept {
  if (light_.cells_.empty()) return open;
  const Parts parts = parts_of(normal);
  Mean m;
  for (int k = 0; k < kLevels && !(m.known > 0.25F); ++k) {
    if ((entered_ >> static_cast<unsigned>(k) & 1U) == 0) enter(k);
    Level& l = levels_[k];
    const Sum &x = sum(l, parts.axis[0]), &y = sum(l, parts.axis[1]), &z = sum(l, parts.axis[2]);
    const float held =
        x.weight[2] * parts.weight[0] + y.weight[2] * parts.weight[1] + z.weight[2] * parts.weight[2];
    if (held >= kEnough) m = mean_of(x, y, z, parts);
  }
  if (!(m.known > 0.25F)) {
    const Sum(&all)[6] = light_.everywhere_;
    m = mean_of(all[parts.axis[0]], all[parts.axis[1]], all[parts.axis[2]], parts);
  }
  if (!(m.known > 0)) return open;
  // What the open sky sends is known by its integral; the rays' mean differs from it by what they met. In
  // the open, nothing is left to chance.
  const float each = 1.0F / m.known, free = m.free * each;
  return not_negative(open * free + (m.sky - m.open * free + m.scattered) * (kPi * each));
}

}  // namespace rigor::render::light
