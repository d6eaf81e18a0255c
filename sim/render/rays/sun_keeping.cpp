#include "sim/render/rays/sun_keeping.h"

#include <atomic>
#include <bit>
#include <cmath>
#include <new>

#include "sim/render/rays/texel_cell.h"

namespace rigor::render::light {
namespace {

constexpr std::uint64_t kShareBits = 0xFFFF;
constexpr float kWholeShare = 65534;
/// Cells along a triangle's edge: more are none.
constexpr float kMostAlong = 1e6F;

/// Takes a word into a hash.
std::uint64_t with(std::uint64_t h, std::uint64_t word) noexcept {
  h = (h ^ word) * 0x9E3779B97F4A7C15ULL;
  return h ^ (h >> 29U);
}
std::uint64_t with(std::uint64_t h, int high, int low) noexcept {
  return with(h, std::uint64_t{static_cast<std::uint32_t>(high)} << 32U | static_cast<std::uint32_t>(low));
}
/// Spreads what bits there are over all of them (Murmur3's finaliser).
std::uint64_t spread(std::uint64_t h) noexcept {
  h = (h ^ (h >> 33U)) * 0xFF51AFD7ED558CCDULL;
  h = (h ^ (h >> 33U)) * 0xC4CEB9FE1A85EC53ULL;
  return h ^ (h >> 33U);
}

/// A triangle in its plane: the first edge is an axis.
struct Flat {
  float length_m;           ///< of the first edge
  float along_m, across_m;  ///< where the third corner lies
  explicit Flat(const RayScene::Triangle& t) noexcept
      : length_m(length(t.e1)),
        along_m(dot(t.e2, t.e1) / length_m),
        across_m(std::sqrt(std::max(dot(t.e2, t.e2) - along_m * along_m, 0.0F))) {}
};

}  // namespace

SunCell sun_cell(const RayScene::Triangle& t, const Intersection& m, float width_m) noexcept {
  SunCell cell;
  const Flat flat(t);
  if (!(flat.length_m > 0) || !(flat.across_m > 0) || !(width_m > 1e-6F)) return cell;
  // The nearest power of two: its exponent, counted from the square root of a half on.
  const std::uint32_t side = std::bit_cast<std::uint32_t>(width_m * 1.41421356F) & 0xFF800000U;
  const float side_m = std::bit_cast<float>(side), per_m = 1 / side_m;
  const float x = (m.u * flat.length_m + m.v * flat.along_m) * per_m, y = m.v * flat.across_m * per_m;
  if (!(std::abs(x) < kMostAlong) || !(std::abs(y) < kMostAlong)) return cell;
  cell.column = static_cast<int>(floor_of(x));
  cell.row = static_cast<int>(floor_of(y));
  cell.side_m = side_m;
  std::uint64_t h = with(side, m.instance);
  h = with(h, static_cast<int>(m.part), static_cast<int>(m.triangle));
  cell.group = with(h, cell.column >> 2, cell.row >> 1) | 1U;
  return cell;
}

Vec3 middle_of(const RayScene::Triangle& t, const SunCell& cell) noexcept {
  const Flat flat(t);
  const float x = (static_cast<float>(cell.column) + 0.5F) * cell.side_m,
              y = (static_cast<float>(cell.row) + 0.5F) * cell.side_m;
  const float v = std::clamp(y / flat.across_m, 0.0F, 1.0F);
  const float u = std::clamp((x - v * flat.along_m) / flat.length_m, 0.0F, 1.0F - v);
  return t.corner + t.e1 * u + t.e2 * v;
}

void KeptSun::about(const Key& k) {
  if (!slots_) {
    // Empty pages, which take memory when they are written.
    slots_.reset(static_cast<std::uint64_t*>(std::calloc(kCells, sizeof(std::uint64_t))));
    if (!slots_) throw std::bad_alloc();
  }
  std::uint64_t h = with(0, k.still_version);
  for (int i = 0; i < 3; ++i) h = with(h, std::bit_cast<std::uint64_t>(k.scene_origin[i]));
  for (const float f : {k.to_sun.x, k.to_sun.y, k.to_sun.z, k.sun_radius_rad})
    h = with(h, std::bit_cast<std::uint32_t>(f));
  salt_ = h;
}

KeptSun::Slot KeptSun::slot_of(const SunCell& cell) const noexcept {
  const std::uint64_t h = spread(with(salt_, cell.group));
  const auto within = static_cast<std::size_t>((cell.column & 3) | (cell.row & 1) << 2);
  return {static_cast<std::size_t>(h % (kCells / 8)) * 8 + within, h & ~kShareBits};
}

void KeptSun::fetch(const SunCell& cell) const noexcept {
  if (cell.any()) __builtin_prefetch(&slots_[slot_of(cell).at]);
}

std::optional<float> KeptSun::find(const SunCell& cell) const noexcept {
  const Slot slot = slot_of(cell);
  const std::uint64_t kept = std::atomic_ref(slots_[slot.at]).load(std::memory_order_relaxed);
  if ((kept & ~kShareBits) != slot.tag || (kept & kShareBits) == 0) return {};
  return static_cast<float>((kept & kShareBits) - 1) / kWholeShare;
}

float KeptSun::keep(const SunCell& cell, float share) noexcept {
  const Slot slot = slot_of(cell);
  const auto rounded = static_cast<std::uint64_t>(std::clamp(share, 0.0F, 1.0F) * kWholeShare + 0.5F);
  std::atomic_ref(slots_[slot.at]).store(slot.tag | (rounded + 1), std::memory_order_relaxed);
  return static_cast<float>(rounded) / kWholeShare;
}

}  // namespace rigor::render::light
