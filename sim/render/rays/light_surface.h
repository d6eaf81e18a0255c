// Surfaces with their maps as the tracer of light asks for them: in four bands, in linear light, over levels
// of detail. Internal to sim/render/rays.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <memory>
#include <mutex>
#include <unordered_map>
#include <vector>

#include "sim/render/content/content.h"
#include "sim/render/rays/embree_placement.h"
#include "sim/render/rays/light_shading.h"

namespace rigor::render::light {

/// A texture and its halves, each the mean of four texels of the one before; colours in linear light,
/// weighted by coverage where it counts. They are made when one is first looked at: most tiles of the ground
/// never are. Any thread.
class MipMap {
 public:
  MipMap(std::shared_ptr<const Texture> texture, bool weigh_by_coverage);
  /// Red, green, blue in linear light and coverage, bilinear in one level. `lod`: log2 of texels of the
  /// finest level that one sample stands for. Any u, v.
  [[nodiscard]] Bands4 at(float u, float v, float lod) const noexcept;
  /// Half of log2 of the finest level's texels: what a sample of one whole picture stands for.
  [[nodiscard]] float size_lod() const noexcept { return size_lod_; }

 private:
  struct Level {
    std::uint32_t width = 1, height = 1, tiles_across = 1;
    std::size_t first = 0;
  };
  [[nodiscard]] Bands4 texel(const Level& l, std::uint32_t x, std::uint32_t y) const noexcept;
  void make() const;
  std::shared_ptr<const Texture> texture_;
  bool weigh_;
  mutable std::once_flag making_;
  mutable std::atomic<bool> made_{false};
  mutable std::vector<Level> levels_;
  mutable std::vector<std::uint32_t> texels_;  ///< red in the lowest byte; tiles of 4 x 4, a cache line each
  const float* decode_ = nullptr;              ///< of a byte of colour
  float size_lod_ = 0;
  bool repeat_ = true;
};

struct LightSurface {
  Bands4 reflectance{}, transmittance{};
  std::array<Bands4, 3> from_colour{}, from_near_infrared{};
  const MipMap *colour = nullptr, *near_infrared = nullptr, *normal = nullptr, *gloss = nullptr;
  float roughness = 1, metallic = 0, porosity = 0.5F, retro_reflection = 0, takes_snow = 1;
  bool translucent = false, glossy = false, water = false;
  bool any_map = false;

  /// At a place of its texture. `lod`: log2 of the part of the whole map's side that a ray stands for.
  /// `tint`: by band.
  [[nodiscard]] MaterialSample patch(float u, float v, float lod, Bands4 tint) const noexcept;
  /// The normal map's direction about a normal. `right`, `down`: gradients of u and v on the surface, times
  /// any one number above 0.
  [[nodiscard]] Vec3 normal_mapped(float u, float v, float lod, Vec3 right, Vec3 down,
                                   Vec3 flat) const noexcept;
};

/// How red, green and blue of a tint multiply the bands: visible ones each by its own, near infrared by their
/// mean.
[[nodiscard]] std::array<Bands4, 3> tint_to_band(const std::array<int, 4>& bands) noexcept;

/// The surfaces of what is in view, in some bands. One thread changes it, any number ask.
class LightSurfaces {
 public:
  LightSurfaces();
  /// Takes over what is new in a content; forgets what has not been in the last ones.
  void update(const WantedContent& content, const std::array<int, 4>& bands);
  /// Of a surface of the window; a matt grey for any other.
  [[nodiscard]] const LightSurface& of(const Surface* s) const noexcept;

 private:
  struct Kept {
    std::shared_ptr<const Surface> surface;
    std::unique_ptr<LightSurface> made;
    std::uint64_t last_seen = 0;
  };
  struct KeptMap {
    std::unique_ptr<MipMap> map;
    std::uint64_t last_seen = 0;
  };
  void add(const std::vector<WantedBatch>& batches);
  void add(const std::shared_ptr<const Surface>& s);
  void fill(const Surface& s, LightSurface& out);
  [[nodiscard]] const MipMap* map(const std::shared_ptr<const Texture>& t, bool weigh);
  void index();

  std::uint64_t round_ = 0;  ///< counts contents that stand still
  std::uint64_t still_version_ = 0, moving_version_ = 0;
  bool grown_ = false;
  std::array<int, 4> bands_{-1, -1, -1, -1};
  std::unordered_map<std::uint64_t, Kept> surfaces_;                   ///< by serial
  std::unordered_map<std::uint64_t, KeptMap> maps_;                    ///< by serial and weighing
  std::vector<std::pair<const Surface*, const LightSurface*>> slots_;  ///< open addressing
  std::shared_ptr<const Surface> grey_;
  LightSurface grey_made_;
};

}  // namespace rigor::render::light
