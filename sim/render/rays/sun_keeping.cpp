#include "sim/render/rays/sun_keeping.h"

#include <algorithm>
#include <atomic>
#include <bit>
#include <cmath>
#include <limits>

#include "sim/render/rays/texel_cell.h"

namespace rigor::render::light {
namespace {

constexpr std::uint64_t kAnswerBits = 0xFFFF;
/// Answers: 1 to 65534 are shares, of leaves.
constexpr std::uint64_t kAllClear = 65533, kNoLeaves = 65535;
constexpr float kMostAlongAnEdge = 1e6F;  // cells
constexpr std::size_t kLine = 64;         // bytes

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

struct Vec2 {
  float x = 0, y = 0;
};
/// Between two places the one that is nearest to p.
Vec2 nearest_between(Vec2 a, Vec2 b, Vec2 p) noexcept {
  const float x = b.x - a.x, y = b.y - a.y;
  const float t =
      std::clamp(((p.x - a.x) * x + (p.y - a.y) * y) / std::max(x * x + y * y, 1e-30F), 0.0F, 1.0F);
  return {a.x + t * x, a.y + t * y};
}

}  // namespace

SunCell sun_cell(const RayScene::Triangle& t, const Intersection& m, float width_m) noexcept {
  SunCell cell;
  const Flat flat(t);
  if (!(flat.length_m > 0) || !(flat.across_m > 0) || !(width_m > 1e-6F)) return cell;
  // The nearest power of two: its exponent, counted from the square root of a half on.
  const std::uint32_t side = std::bit_cast<std::uint32_t>(width_m * 1.41421356F) & 0xFF800000U;
  const float side_m = std::bit_cast<float>(side), per_m = 1 / side_m;
  const float x = (m.u * flat.length_m + m.v * flat.along_m) * per_m, y = m.v * flat.across_m * per_m;
  if (!(std::abs(x) < kMostAlongAnEdge) || !(std::abs(y) < kMostAlongAnEdge)) return cell;
  cell.column = static_cast<int>(floor_of(x));
  cell.row = static_cast<int>(floor_of(y));
  cell.side_m = side_m;
  std::uint64_t h = with(with(0, side), m.instance);
  h = with(h, static_cast<int>(m.part), static_cast<int>(m.triangle));
  cell.group = with(h, cell.column >> 2, cell.row >> 1) | 1U;
  return cell;
}

Vec3 middle_of(const RayScene::Triangle& t, const SunCell& cell) noexcept {
  const Flat flat(t);
  const Vec2 middle{(static_cast<float>(cell.column) + 0.5F) * cell.side_m,
                    (static_cast<float>(cell.row) + 0.5F) * cell.side_m};
  const auto place = [&](Vec2 p) {
    const float v = p.y / flat.across_m;
    return t.corner + t.e1 * ((p.x - v * flat.along_m) / flat.length_m) + t.e2 * v;
  };
  const Vec2 a, b{flat.length_m, 0}, c{flat.along_m, flat.across_m};
  const auto left_of = [&](Vec2 from, Vec2 to) {
    return (to.x - from.x) * (middle.y - from.y) - (to.y - from.y) * (middle.x - from.x) >= 0;
  };
  if (left_of(a, b) && left_of(b, c) && left_of(c, a)) return place(middle);
  Vec2 nearest;
  float least = std::numeric_limits<float>::infinity();
  for (const Vec2 p :
       {nearest_between(a, b, middle), nearest_between(b, c, middle), nearest_between(c, a, middle)}) {
    const float x = p.x - middle.x, y = p.y - middle.y;
    if (!(x * x + y * y < least)) continue;
    least = x * x + y * y;
    nearest = p;
  }
  return place(nearest);
}

bool KeptSun::about(std::uint64_t still_serial, Vec3 to_sun, float sun_radius_rad) noexcept {
  if (slots_ == nullptr) {
    // Empty pages, which take memory when they are written.
    memory_.reset(std::calloc(kSlots * sizeof(std::uint64_t) + kLine, 1));
    if (!memory_) return false;
    void* begin = memory_.get();
    std::size_t room = kSlots * sizeof(std::uint64_t) + kLine;
    slots_ = static_cast<std::uint64_t*>(std::align(kLine, kSlots * sizeof(std::uint64_t), begin, room));
  }
  std::uint64_t h = with(0, still_serial);
  for (const float f : {to_sun.x, to_sun.y, to_sun.z, sun_radius_rad})
    h = with(h, std::bit_cast<std::uint32_t>(f));
  salt_ = h;
  return true;
}

KeptSun::Slot KeptSun::slot_of(const SunCell& cell) const noexcept {
  const std::uint64_t h = spread(with(salt_, cell.group));
  // Small triangles have one cell, the first of its group: groups begin at any of their eight places.
  const std::uint64_t within =
      static_cast<std::uint64_t>((cell.column & 3) | (cell.row & 1) << 2) ^ (h >> 61U);
  return {static_cast<std::size_t>(h % (kSlots / 8) * 8 + within), h & ~kAnswerBits};
}

void KeptSun::fetch(const SunCell& cell) const noexcept { __builtin_prefetch(&slots_[slot_of(cell).at]); }

std::optional<SunShare> KeptSun::find(const SunCell& cell) const noexcept {
  const Slot slot = slot_of(cell);
  const std::uint64_t kept = std::atomic_ref(slots_[slot.at]).load(std::memory_order_relaxed),
                      answer = kept & kAnswerBits;
  if ((kept & ~kAnswerBits) != slot.tag || answer == 0) return {};
  if (answer == kNoLeaves) return SunShare{};
  return SunShare{static_cast<float>(answer - 1) / static_cast<float>(kAllClear), true};
}

SunShare KeptSun::keep(const SunCell& cell, SunShare share) noexcept {
  const Slot slot = slot_of(cell);
  const auto rounded =
      static_cast<std::uint64_t>(std::clamp(share.clear, 0.0F, 1.0F) * static_cast<float>(kAllClear) + 0.5F);
  std::atomic_ref(slots_[slot.at])
      .store(slot.tag | (share.leaves ? rounded + 1 : kNoLeaves), std::memory_order_relaxed);
  return share.leaves ? SunShare{static_cast<float>(rounded) / static_cast<float>(kAllClear), true}
                      : SunShare{};
}

}  // namespace rigor::render::light
