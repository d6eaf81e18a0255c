#include "sim/render/rays/light_cover.h"

#include <algorithm>
#include <cmath>
#include <thread>
#include <unordered_map>

namespace rigor::render::light {
namespace {

// Numbers of the view engine: shadow_cascades.h, view_renderer.cpp, view_frame.cpp, light.glsl.
constexpr int kCoverSide = 1024;
constexpr double kTexel_m = 0.25;
constexpr float kPerM = static_cast<float>(1 / kTexel_m);
constexpr float kRise_m = 0.3F, kOff_m = 0.15F;
constexpr Spectrum kLeafScatters{0.12F, 0.24F, 0.08F, 0.92F, 0.92F, 0.60F};
constexpr float kLeafDepth = 2.0F, kWallShare = 0.1F;
/// Heights from which the map is shot, above the scene's cell.
constexpr float kAbove_m = 1500;
constexpr float kNothing_m = -1e6F;

/// Squares of texels that are shot together.
constexpr std::int64_t kBlockSide = 8;
constexpr std::size_t kBlocks = kCoverSide / kBlockSide;
static_assert(static_cast<std::int64_t>(ContentQuery::kEyeCell_m / kTexel_m) % kBlockSide == 0,
              "the map begins with a block");

std::size_t place(std::int64_t x, std::int64_t y) {
  return static_cast<std::size_t>((y & (kCoverSide - 1)) * kCoverSide + (x & (kCoverSide - 1)));
}

std::size_t block(std::int64_t x, std::int64_t y) {
  const auto at = [](std::int64_t v) {
    return static_cast<std::size_t>((v & (kCoverSide - 1)) / kBlockSide);
  };
  return at(y) * kBlocks + at(x);
}

bool has_leaves(const Prototype& p) {
  for (const LevelOfDetail& l : p.levels)
    if (l.mesh)
      for (const MeshPart& part : l.mesh->parts)
        if (part.surface && std::any_of(part.surface->transmittance.begin(),
                                        part.surface->transmittance.end(), [](float t) { return t > 0; }))
          return true;
  return false;
}

}  // namespace

SkyCover::Area SkyCover::area_of(const Eigen::AlignedBox3d& box) {
  const auto texel = [](double v) {
    return static_cast<std::int64_t>(std::floor(std::clamp(v, -1e9, 1e9) / kTexel_m));
  };
  if (box.isEmpty() || !box.min().allFinite() || !box.max().allFinite())
    return {INT64_MIN, INT64_MIN, INT64_MAX, INT64_MAX};
  return {texel(box.min().x()) - 1, texel(box.min().y()) - 1, texel(box.max().x()) + 2,
          texel(box.max().y()) + 2};
}

SkyCover::Casters SkyCover::casters_of(const std::vector<WantedBatch>& batches) {
  std::unordered_map<const Prototype*, bool> leaves;
  Casters all;
  for (const WantedBatch& w : batches) {
    const Batch& b = *w.frames.front();
    if (!b.prototype->casts_shadow) continue;
    const auto [known, fresh] = leaves.try_emplace(b.prototype.get());
    if (fresh) known->second = has_leaves(*b.prototype);
    all.push_back({w.made, b.bounds, known->second});
  }
  std::sort(all.begin(), all.end(), [](const Caster& a, const Caster& b) { return a.batch < b.batch; });
  return all;
}

void SkyCover::exchange(Casters& casters, Casters now, std::vector<Area>& stale) {
  const auto differing = [&](const Casters& a, const Casters& b) {
    for (const Caster& c : a)
      if (!std::binary_search(b.begin(), b.end(), c,
                              [](const Caster& p, const Caster& q) { return p.batch < q.batch; }))
        stale.push_back(area_of(c.bounds));
  };
  differing(now, casters);
  differing(casters, now);
  casters = std::move(now);
}

void SkyCover::update(const RayScene& scene, const WantedContent& content, const Eigen::Vector3d& eye) {
  const auto first = [](double v) {
    constexpr double kCell = ContentQuery::kEyeCell_m;
    return static_cast<std::int64_t>(std::floor(v / kCell) * (kCell / kTexel_m)) - kCoverSide / 2;
  };
  const std::int64_t x0 = first(eye.x()), y0 = first(eye.y());
  const Area map{x0, y0, x0 + kCoverSide, y0 + kCoverSide};
  to_texel_x_ = static_cast<float>(scene.origin().x() / kTexel_m - static_cast<double>(x0));
  to_texel_y_ = static_cast<float>(scene.origin().y() / kTexel_m - static_cast<double>(y0));
  origin_z_ = static_cast<float>(scene.origin().z());

  scene_ = &scene;
  // Several times a picture nothing has changed.
  if (filled_ && scene.origin() != origin_) filled_ = false;
  if (filled_ && x0 == x0_ && y0 == y0_ && content.still_version == still_version_ &&
      content.moving_version == moving_version_)
    return;
  origin_ = scene.origin();
  std::vector<Area> stale;
  if (content.still_version != still_version_ || content.moving_version != moving_version_) {
    if (content.still_version != still_version_) exchange(still_, casters_of(content.still), stale);
    if (content.moving_version != moving_version_) exchange(moving_, casters_of(content.moving), stale);
    still_version_ = content.still_version;
    moving_version_ = content.moving_version;
    leaves_ = rises_ = false;
    Eigen::AlignedBox3d bounds;
    for (const Casters* const casters : {&still_, &moving_})
      for (const Caster& c : *casters) {
        leaves_ = leaves_ || c.leaves;
        rises_ = rises_ || c.bounds.isEmpty();  // not known
        bounds.extend(c.bounds);
      }
    rises_ = rises_ || (!bounds.isEmpty() && !(bounds.sizes().z() <= kRise_m));
  }
  if (!filled_) {
    top_m_.resize(std::size_t{kCoverSide} * kCoverSide);
    if (!blocks_) blocks_ = std::make_unique<std::atomic<State>[]>(kBlocks * kBlocks);
    stale = {map};
  } else if (x0 != x0_ || y0 != y0_) {
    // What came into the map on either side.
    const std::int64_t dx = std::clamp<std::int64_t>(x0 - x0_, -kCoverSide, kCoverSide);
    const std::int64_t dy = std::clamp<std::int64_t>(y0 - y0_, -kCoverSide, kCoverSide);
    if (dx != 0)
      stale.push_back(dx > 0 ? Area{map.x1 - dx, map.y0, map.x1, map.y1}
                             : Area{map.x0, map.y0, map.x0 - dx, map.y1});
    if (dy != 0)
      stale.push_back(dy > 0 ? Area{map.x0, map.y1 - dy, map.x1, map.y1}
                             : Area{map.x0, map.y0, map.x1, map.y0 - dy});
  }
  x0_ = x0;
  y0_ = y0;
  filled_ = true;
  for (const Area& a : stale)
    for (std::int64_t y = std::max(a.y0, map.y0) & ~(kBlockSide - 1); y < std::min(a.y1, map.y1);
         y += kBlockSide)
      for (std::int64_t x = std::max(a.x0, map.x0) & ~(kBlockSide - 1); x < std::min(a.x1, map.x1);
           x += kBlockSide)
        blocks_[block(x, y)].store(State::stale, std::memory_order_relaxed);
}

void SkyCover::shoot(std::int64_t x, std::int64_t y) const noexcept {
  std::atomic<State>& state = blocks_[block(x, y)];
  State was = State::stale;
  if (!state.compare_exchange_strong(was, State::busy)) {
    while (state.load(std::memory_order_acquire) != State::known) std::this_thread::yield();
    return;
  }
  x &= ~(kBlockSide - 1);
  y &= ~(kBlockSide - 1);
  constexpr unsigned kTexels = kBlockSide * kBlockSide;
  // Packets of four by two texels.
  const auto tx = [&](unsigned i) { return x + i / 8 % 2 * 4 + i % 4; };
  const auto ty = [&](unsigned i) { return y + i / 16 * 2 + i % 8 / 4; };
  RayPackets rays;
  const float down[3] = {0, 0, -1};
  for (unsigned i = 0; i < kTexels; ++i) {
    const float from[3] = {static_cast<float>((static_cast<double>(tx(i)) + 0.5) * kTexel_m - origin_.x()),
                           static_cast<float>((static_cast<double>(ty(i)) + 0.5) * kTexel_m - origin_.y()),
                           kAbove_m};
    rays.set(i, from, down, 0, std::numeric_limits<float>::infinity(), 0, kShadowMask);
  }
  scene_->intersect(rays, kTexels, true);
  for (unsigned i = 0; i < kTexels; ++i) {
    const Intersection m = rays.intersection(i);
    top_m_[place(tx(i), ty(i))] =
        m.nothing() ? kNothing_m
                    : static_cast<float>(origin_.z() + static_cast<double>(kAbove_m - m.range_m));
  }
  state.store(State::known, std::memory_order_release);
}

float SkyCover::top_m(std::int64_t x, std::int64_t y) const noexcept {
  if (blocks_[block(x, y)].load(std::memory_order_acquire) != State::known) shoot(x, y);
  return top_m_[place(x, y)];
}

float SkyCover::seen(Vec3 p, Vec3 n, bool sided) const noexcept {
  constexpr float kRadii[3] = {0.8F, 3.2F, 13.0F};
  // Off a wall, whose own top would else cover it.
  const float off = sided ? 2.0F * static_cast<float>(kTexel_m) : 0.0F;
  const float u = (p.x + n.x * off) * kPerM + to_texel_x_, v = (p.y + n.y * off) * kPerM + to_texel_y_;
  const float inside = std::min(std::min(u, v), kCoverSide - std::max(u, v)) * (1.0F / kCoverSide);
  const float known = std::clamp(inside * 10.0F, 0.0F, 1.0F);
  if (!(known > 0)) return 1;
  const float z = p.z + origin_z_ + kOff_m;
  float open = 0, most = 0, x = 0.92387953F, y = -0.38268343F;
  const float cosine = sided ? 0.70710678F : 0.0F, sine = sided ? -0.70710678F : -1.0F;
  const float steep = 1.0F / std::max(n.z, 0.05F);
  for (int a = 0; a < 8; a += sided ? 1 : 2) {
    // The surface's own plane: what lies below it gives it no light.
    const float own = sided ? std::max(-(n.x * x + n.y * y) * steep, 0.0F) : 0.0F;
    float horizon = own;
    for (const float r : kRadii) {
      const int i = std::clamp(static_cast<int>(u + x * r * kPerM), 0, kCoverSide - 1);
      const int j = std::clamp(static_cast<int>(v + y * r * kPerM), 0, kCoverSide - 1);
      horizon = std::max(horizon, (top_m(x0_ + i, y0_ + j) - z) / r);
    }
    open += 1.0F / (1.0F + horizon * horizon);
    most += 1.0F / (1.0F + own * own);
    const float turned = x * cosine - y * sine;
    y = x * sine + y * cosine;
    x = turned;
  }
  return mix(1.0F, open / most, known);
}

SkyCover::Instead SkyCover::instead(const LightFrame& light, const std::array<int, 4>& bands) const noexcept {
  Instead out;
  if (!leaves_) {
    out.share = all_bands(kWallShare);
    return out;
  }
  Spectrum share{};
  for (std::size_t b = 0; b < share.size(); ++b)
    share[b] = std::exp(-kLeafDepth * std::sqrt(1 - kLeafScatters[b]));
  out.share = pick(share, bands);
  out.irradiance =
      (out.share - std::exp(-kLeafDepth)) * std::max(light.to_sun.z, 0.0F) * light.sun_irradiance;
  return out;
}

}  // namespace rigor::render::light
