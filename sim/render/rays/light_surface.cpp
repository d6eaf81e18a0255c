#include "sim/render/rays/light_surface.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <unordered_set>

#include "sim/render/content/texels.h"

namespace rigor::render::light {
namespace {

/// Contents that stand still for which what is unseen is kept.
constexpr std::uint64_t kRoundsKept = 16;

/// Of what lies well within an int. (std::floor is a call where the processor's own rounding may not be
/// used.)
float whole(float v) {
  const auto i = static_cast<float>(static_cast<int>(v));
  return i > v ? i - 1.0F : i;
}

Bands4 clamped(const Spectrum& s, const std::array<int, 4>& bands) {
  Bands4 v = pick(s, bands);
  for (int b = 0; b < 4; ++b) v[b] = v[b] > 0 && std::isfinite(v[b]) ? v[b] : 0.0F;
  return v;
}
float share(float v, float otherwise) { return std::isfinite(v) ? std::clamp(v, 0.0F, 1.0F) : otherwise; }

std::array<Bands4, 3> in_bands(const ColourToBand& m) { return std::bit_cast<std::array<Bands4, 3>>(m); }

}  // namespace

MipMap::MipMap(std::shared_ptr<const Texture> texture, bool weigh)
    : texture_(std::move(texture)),
      weigh_(weigh),
      decode_(linear_of_bytes(texture_->srgb)),
      size_lod_(0.5F * std::log2(static_cast<float>(texture_->width) * static_cast<float>(texture_->height))),
      repeat_(texture_->repeat) {}

void MipMap::make() const {
  const Texture& t = *texture_;
  LinearTexels now = linear_texels(t);
  for (;;) {
    const Level l{now.width, now.height, (now.width + 3) / 4, texels_.size()};
    texels_.resize(l.first + std::size_t{l.tiles_across} * ((l.height + 3) / 4) * 16);
    const std::vector<std::uint8_t> coarser =
        l.first == 0 ? std::vector<std::uint8_t>() : bytes_of(now, t.srgb);
    const std::uint8_t* const bytes = l.first == 0 ? t.rgba.data() : coarser.data();
    for (std::uint32_t y = 0; y < l.height; ++y)
      for (std::uint32_t x = 0; x < l.width; ++x) {
        std::uint32_t& to =
            texels_[l.first + (std::size_t{y / 4} * l.tiles_across + x / 4) * 16 + (y % 4) * 4 + x % 4];
        std::memcpy(&to, bytes + 4 * (std::size_t{y} * l.width + x), 4);
      }
    levels_.push_back(l);
    if (now.width == 1 && now.height == 1) break;
    now = halved(now, weigh_);
  }
  made_.store(true, std::memory_order_release);
}

Bands4 MipMap::texel(const Level& l, std::uint32_t x, std::uint32_t y) const noexcept {
  const std::uint32_t p =
      texels_[l.first + (std::size_t{y / 4} * l.tiles_across + x / 4) * 16 + (y % 4) * 4 + x % 4];
  return Bands4{decode_[p & 255U], decode_[p >> 8U & 255U], decode_[p >> 16U & 255U],
                static_cast<float>(p >> 24U) * (1.0F / 255)};
}

Bands4 MipMap::at(float u, float v, float lod) const noexcept {
  if (!made_.load(std::memory_order_acquire)) std::call_once(making_, [this] { make(); });
  const int last = static_cast<int>(levels_.size()) - 1;
  const Level& l = levels_[static_cast<std::size_t>(std::clamp(static_cast<int>(lod + 0.5F), 0, last))];
  const float w = static_cast<float>(l.width), h = static_cast<float>(l.height);
  // Between 0 and 1 first: places far out on a repeated texture have no fraction left.
  const auto wrapped = [](float a) {
    if (!(std::abs(a) < 1e6F)) return 0.0F;
    a -= whole(a);
    return a < 1.0F ? a : 0.0F;
  };
  const auto bounded = [](float a) { return a > 0.0F ? std::min(a, 1.0F) : 0.0F; };
  const float x = (repeat_ ? wrapped(u) : bounded(u)) * w - 0.5F;
  const float y = (repeat_ ? wrapped(v) : bounded(v)) * h - 0.5F;
  const float x0 = whole(x), y0 = whole(y), fx = x - x0, fy = y - y0;
  const auto place = [this](int i, std::uint32_t n) {
    const int end = static_cast<int>(n);
    if (i < 0) return repeat_ ? n - 1 : 0U;
    if (i >= end) return repeat_ ? 0U : n - 1;
    return static_cast<std::uint32_t>(i);
  };
  const std::uint32_t left = place(static_cast<int>(x0), l.width),
                      right = place(static_cast<int>(x0) + 1, l.width);
  const std::uint32_t top = place(static_cast<int>(y0), l.height),
                      low = place(static_cast<int>(y0) + 1, l.height);
  return mix(mix(texel(l, left, top), texel(l, right, top), fx),
             mix(texel(l, left, low), texel(l, right, low), fx), fy);
}

MaterialSample LightSurface::patch(float u, float v, float lod, Bands4 tint) const noexcept {
  MaterialSample s{};
  Bands4 factor = tint;
  if (colour != nullptr || near_infrared != nullptr) {
    const Bands4 c = colour != nullptr ? colour->at(u, v, lod + colour->size_lod()) : all_bands(1);
    Bands4 f = from_colour[0] * c[0] + from_colour[1] * c[1] + from_colour[2] * c[2];
    if (near_infrared != nullptr) {
      const Bands4 n = near_infrared->at(u, v, lod + near_infrared->size_lod());
      f += from_near_infrared[0] * n[0] + from_near_infrared[1] * n[1] + from_near_infrared[2] * n[2];
    }
    factor *= f;
  }
  s.reflectance = reflectance * factor;
  s.transmittance = transmittance * factor;
  s.roughness = roughness;
  if (gloss != nullptr) s.roughness *= 1.0F - 0.95F * gloss->at(u, v, lod + gloss->size_lod())[0];
  s.metallic = metallic;
  s.porosity = porosity;
  s.retro_reflection = retro_reflection;
  s.translucent = translucent;
  s.glossy = glossy;
  s.water = water;
  s.takes_snow = takes_snow;
  return s;
}

Vec3 LightSurface::normal_mapped(float u, float v, float lod, Vec3 right, Vec3 down,
                                 Vec3 flat) const noexcept {
  const float longest = std::max(dot(right, right), dot(down, down));
  if (!(longest > 0) || !std::isfinite(longest)) return flat;
  const Bands4 m = normal->at(u, v, lod + normal->size_lod()) * 2.0F - 1.0F;
  const float scale = 1.0F / std::sqrt(longest);
  return unit(right * (scale * m[0]) - down * (scale * m[1]) + flat * std::max(m[2], 0.05F), flat);
}

std::array<Bands4, 3> tint_to_band(const std::array<int, 4>& bands) noexcept {
  return in_bands(colour_to_band(bands, true));
}

LightSurfaces::LightSurfaces() {
  Surface grey;
  grey.name = "unknown";
  grey_ = std::make_shared<const Surface>(std::move(grey));
  index();
}

const MipMap* LightSurfaces::map(const std::shared_ptr<const Texture>& t, bool weigh) {
  if (usable(t) == nullptr) return nullptr;
  KeptMap& kept = maps_[2 * t->serial + (weigh ? 1 : 0)];
  if (!kept.map) kept.map = std::make_unique<MipMap>(t, weigh);
  kept.last_seen = round_;
  return kept.map.get();
}

void LightSurfaces::fill(const Surface& s, LightSurface& out) {
  out = {};
  out.reflectance = clamped(s.reflectance, bands_);
  out.transmittance = clamped(s.transmittance, bands_);
  out.colour = map(s.colour_map, s.alpha_cutoff > 0);
  out.near_infrared = map(s.near_infrared_map, false);
  out.normal = map(s.normal_map, false);
  out.gloss = map(s.gloss_map, false);
  out.from_colour = in_bands(colour_to_band(bands_, out.near_infrared == nullptr));
  out.from_near_infrared = in_bands(near_infrared_to_band(bands_));
  out.roughness = share(s.roughness, 1);
  out.metallic = share(s.metallic, 0);
  out.porosity = share(s.porosity, 0.5F);
  out.retro_reflection = share(s.retro_reflection, 0);
  out.translucent =
      std::any_of(s.transmittance.begin(), s.transmittance.end(), [](float t) { return t > 0; });
  out.glossy = out.roughness < 1 || out.metallic > 0 || out.gloss != nullptr;
  out.water = s.water;
  out.takes_snow = s.takes_snow ? 1.0F : 0.0F;
  out.any_map =
      out.colour != nullptr || out.near_infrared != nullptr || out.normal != nullptr || out.gloss != nullptr;
}

void LightSurfaces::add(const std::shared_ptr<const Surface>& s) {
  Kept& kept = surfaces_[s->serial];
  if (!kept.made) {
    kept.surface = s;
    kept.made = std::make_unique<LightSurface>();
    fill(*s, *kept.made);
    grown_ = true;
  }
  if (kept.last_seen == round_) return;
  kept.last_seen = round_;
  for (const auto& [t, weigh] :
       {std::pair{&s->colour_map, s->alpha_cutoff > 0}, std::pair{&s->near_infrared_map, false},
        std::pair{&s->normal_map, false}, std::pair{&s->gloss_map, false}})
    if (usable(*t) != nullptr) maps_.at(2 * (*t)->serial + (weigh ? 1 : 0)).last_seen = round_;
}

void LightSurfaces::add(const std::vector<WantedBatch>& batches) {
  std::unordered_set<const Prototype*> seen;
  for (const WantedBatch& batch : batches) {
    const Prototype* const prototype = batch.frames.front()->prototype.get();
    if (!seen.insert(prototype).second) continue;
    for (const LevelOfDetail& level : prototype->levels)
      if (level.mesh)
        for (const MeshPart& part : level.mesh->parts)
          if (part.surface) add(part.surface);
  }
}

void LightSurfaces::update(const WantedContent& content, const std::array<int, 4>& bands) {
  if (bands != bands_) {
    bands_ = bands;
    for (auto& [serial, kept] : surfaces_) fill(*kept.surface, *kept.made);
    fill(*grey_, grey_made_);
  }
  if (content.still_version == still_version_ && content.moving_version == moving_version_) return;
  const bool another = content.still_version != still_version_;
  still_version_ = content.still_version;
  moving_version_ = content.moving_version;
  if (another) {
    ++round_;
    add(content.still);
  }
  add(content.moving);
  if (another) {
    const auto old = [this](const auto& e) { return e.second.last_seen + kRoundsKept < round_; };
    grown_ = std::erase_if(surfaces_, old) > 0 || grown_;
    std::erase_if(maps_, old);
  }
  if (grown_) index();
  grown_ = false;
}

void LightSurfaces::index() {
  std::size_t n = 16;
  while (n < 4 * surfaces_.size()) n *= 2;
  slots_.assign(n, {nullptr, nullptr});
  for (const auto& [serial, kept] : surfaces_) {
    std::size_t i = (reinterpret_cast<std::uintptr_t>(kept.surface.get()) >> 4U) & (n - 1);
    while (slots_[i].first != nullptr) i = (i + 1) & (n - 1);
    slots_[i] = {kept.surface.get(), kept.made.get()};
  }
}

const LightSurface& LightSurfaces::of(const Surface* s) const noexcept {
  std::size_t i = (reinterpret_cast<std::uintptr_t>(s) >> 4U) & (slots_.size() - 1);
  for (; slots_[i].first != nullptr; i = (i + 1) & (slots_.size() - 1))
    if (slots_[i].first == s) return *slots_[i].second;
  return grey_made_;
}

}  // namespace rigor::render::light
