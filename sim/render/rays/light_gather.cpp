#include "sim/render/rays/light_gather.h"

#include <algorithm>
#include <cmath>

namespace rigor::render::light {
namespace {

/// Sides of cells are powers of two: 2^kSmallest m to 2^kLargest m.
constexpr int kSmallest = -5, kLargest = 14;
/// A path counts in so many levels, from that of its range on: in thin regions a coarser one answers.
constexpr int kLevels = 4;
/// A level answers where its cells hold at least this weight of paths.
constexpr float kEnough = 12;

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

float scale_of(int level) noexcept { return std::ldexp(1.0F, -level); }

/// Cells of places without bounds: what floats can count.
int floor_of(float v) noexcept { return static_cast<int>(std::floor(std::clamp(v, -1e6F, 1e6F))); }

/// Squares of a unit normal's parts, and which of the six axes they look along.
struct Parts {
  float weight[3];
  int axis[3];
};
Parts parts_of(Vec3 n) noexcept {
  return {{n.x * n.x, n.y * n.y, n.z * n.z}, {n.x < 0 ? 1 : 0, n.y < 0 ? 3 : 2, n.z < 0 ? 5 : 4}};
}

}  // namespace

int GatheredLight::level_of(float range_m) const noexcept {
  const float side = std::max(range_m * cell_rad_, 1e-3F);
  return std::clamp(static_cast<int>(std::lround(std::log2(side))), kSmallest, kLargest - kLevels + 1);
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

void GatheredLight::add(std::span<const GatheredPath> paths) {
  for (const GatheredPath& p : paths) {
    if (!finite(p.place) || !finite(p.normal)) continue;
    const Parts parts = parts_of(p.normal);
    const auto count = [&](Sum(&axis)[6]) {
      for (int k = 0; k < 3; ++k) {
        const float w = parts.weight[k];
        Sum& s = axis[parts.axis[k]];
        s.radiance += p.radiance * w;
        s.open += p.open * w;
        s.weight += w;
        s.free += p.free ? w : 0.0F;
      }
    };
    count(everywhere_);
    const int finest = level_of(p.range_m);
    for (int level = finest; level < finest + kLevels; ++level) {
      const float scale = scale_of(level);
      count(cell(key_of(level, floor_of(p.place.x * scale), floor_of(p.place.y * scale),
                        floor_of(p.place.z * scale)))
                .axis);
    }
  }
}

GatheredLight::Sum GatheredLight::near(int level, Vec3 place, Vec3 normal, Found& found) const noexcept {
  const float scale = scale_of(level);
  const Vec3 at = place * scale - Vec3{0.5F, 0.5F, 0.5F};
  const int x = floor_of(at.x), y = floor_of(at.y), z = floor_of(at.z);
  const auto part = [](float v, int low) { return std::clamp(v - static_cast<float>(low), 0.0F, 1.0F); };
  const float fx = part(at.x, x), fy = part(at.y, y), fz = part(at.z, z);
  const Parts parts = parts_of(normal);
  const std::uint64_t key = key_of(level, x, y, z);
  Found::Eight& eight = found.eights_[hash_of(key) % found.eights_.size()];
  if (eight.key != key) {
    eight.key = key;
    for (int k = 0; k < 8; ++k)
      eight.cells[static_cast<std::size_t>(k)] =
          find(key_of(level, x + (k & 1), y + (k >> 1 & 1), z + (k >> 2)));
  }
  const Cell* cells[8];
  float share[8];
  std::size_t n = 0;
  for (int k = 0; k < 8; ++k) {
    const Cell* const c = eight.cells[static_cast<std::size_t>(k)];
    if (c == nullptr) continue;
    cells[n] = c;
    share[n++] =
        ((k & 1) != 0 ? fx : 1 - fx) * ((k >> 1 & 1) != 0 ? fy : 1 - fy) * (k >> 2 != 0 ? fz : 1 - fz);
  }
  Sum axis[3];
  float held = 0;
  for (int a = 0; a < 3; ++a) {
    Sum sum;
    float all = 0;
    for (std::size_t k = 0; k < n; ++k) {
      const Sum& s = cells[k]->axis[parts.axis[a]];
      sum.radiance += s.radiance * share[k];
      sum.open += s.open * share[k];
      sum.weight += s.weight * share[k];
      sum.free += s.free * share[k];
      all += s.weight;
    }
    axis[a] = sum;
    held += all * parts.weight[a];
  }
  return held >= kEnough ? along(axis, parts.weight) : Sum{};
}

GatheredLight::Sum GatheredLight::along(const Sum (&axis)[3], const float (&weight)[3]) noexcept {
  Sum out;
  for (int a = 0; a < 3; ++a) {
    if (!(axis[a].weight > 1e-3F * weight[a]) || !(weight[a] > 0)) continue;
    const float w = weight[a] / axis[a].weight;
    out.radiance += axis[a].radiance * w;
    out.open += axis[a].open * w;
    out.free += axis[a].free * w;
    out.weight += weight[a];
  }
  return out;
}

Bands4 GatheredLight::irradiance(const LightFrame& frame, Vec3 place, Vec3 normal, float range_m,
                                 Found& found) const noexcept {
  const Bands4 open = frame.irradiance(normal);
  if (cells_.empty()) return open;
  const int finest = level_of(range_m);
  Sum s;
  for (int level = finest; level < finest + kLevels && !(s.weight > 0.25F); ++level)
    s = near(level, place, normal, found);
  if (!(s.weight > 0.25F)) {
    const Parts parts = parts_of(normal);
    s = along({everywhere_[parts.axis[0]], everywhere_[parts.axis[1]], everywhere_[parts.axis[2]]},
              parts.weight);
  }
  if (!(s.weight > 0)) return open;
  // What the open sky sends is known by its integral; the paths' mean differs from it by what they met. In
  // the open, nothing is left to chance.
  const float each = 1.0F / s.weight, free = s.free * each;
  return not_negative(open * free + (s.radiance - s.open * free) * (kPi * each));
}

}  // namespace rigor::render::light
