// What a sensor that measures along rays asks of an engine, and what it gets. Two engines answer the same
// question:
//
//   rays     sim/render/rays     Embree on the CPU: exact for every ray, its origin and its instant
//   vulkan   sim/render/view     raster views that hold what is seen, sampled along the rays
//
//   auto engine = EmbreeEngine::create({...});
//   engine->prepare(window);                                   // takes over what is new in the content
//   engine->cast({.origin = p_world, .band = 4, .rays = rays}, hits);
//
// The same content, query and options give the same hits, on any number of threads.
#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <limits>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "rt-core/result.h"
#include "sim/render/engine/content_window.h"

namespace rigor::render {

/// Rays that follow each other in a query should be near each other: engines work on them in packets.
struct Ray {
  float origin[3]{};     ///< relative to RayQuery::origin, world axes, m
  float direction[3]{};  ///< unit length, world axes
  float time = 0;        ///< instant: 0 the window's begin … 1 its end
  float far_m = std::numeric_limits<float>::infinity();
};

/// What a ray meets first. Reflectance is that of RayQuery::band with colour or near-infrared map, tint,
/// wetness and snow applied, as content.h says it of a Surface; roughness with the gloss map, the normal with
/// the normal map.
struct Hit {
  float range_m = std::numeric_limits<float>::infinity();  ///< along the ray; infinity: nothing
  float normal[3]{};        ///< shading normal, world axes, unit length, turned towards the ray's origin
  float cos_incidence = 0;  ///< of the shading normal and the ray back, 0 to 1
  float reflectance = 0, transmittance = 0;  ///< diffuse
  float roughness = 1, metallic = 0, retro_reflection = 0;
  float uv[2]{};
  bool water = false;
  NodeId node{};                     ///< what it is in the world
  const Surface* surface = nullptr;  ///< material; lives as long as the window that was prepared

  [[nodiscard]] bool nothing() const noexcept { return !(range_m < std::numeric_limits<float>::infinity()); }
};

struct RayQuery {
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();  ///< world frame; near the rays' origins
  int band = 4;                                      ///< index of world::kBandWavelength_nm
  float near_m = 0.001F;                             ///< nothing nearer is met
  std::span<const Ray> rays;
  /// Of cast_layers(): rays are squares of this half width where they start, and grow by so much a metre.
  float half_width_m = 0, half_width_per_m = 0;
};

/// One of the surfaces that a wide ray meets.
struct PartialHit {
  Hit hit;
  float share =
      1;  ///< of the ray that it covers; those of a ray add up to 1 unless a part of it meets nothing
};
/// What the rays of a query meet, nearest first.
class LayeredHits {
 public:
  /// What lies behind the last one that is told counts as part of it.
  static constexpr std::size_t kMost = 7;
  void resize(std::size_t rays) {
    hits_.resize(rays * kMost);
    counts_.resize(rays);
  }
  [[nodiscard]] std::size_t rays() const noexcept { return counts_.size(); }
  [[nodiscard]] std::span<const PartialHit> of(std::size_t ray) const noexcept {
    return {&hits_[ray * kMost], counts_[ray]};
  }
  void clear(std::size_t ray) noexcept { counts_[ray] = 0; }
  /// At most kMost to a ray.
  PartialHit& add(std::size_t ray) noexcept { return hits_[ray * kMost + counts_[ray]++]; }

 private:
  std::vector<PartialHit> hits_;
  std::vector<std::uint8_t> counts_;
};

struct EngineStatistics {
  double prepare_ms = 0, cast_ms = 0;  ///< of the last call of each
  std::size_t instances = 0;           ///< that can be met
  std::size_t prototypes = 0;          ///< meshes in use: levels of detail
  std::size_t triangles = 0;           ///< of these meshes, each once
  std::size_t rebuilt = 0;             ///< meshes that the last prepare had to take in anew
  std::size_t left_out = 0;            ///< instances and triangles that cannot be measured
};

/// One thread at a time calls an engine; inside it may use several.
class RayEngine {
 public:
  virtual ~RayEngine() = default;
  /// "rays" or "raster".
  [[nodiscard]] virtual std::string_view name() const = 0;
  /// Each ray starts where it says; else all of a query start at the query's origin.
  [[nodiscard]] virtual bool own_origins() const { return true; }
  /// The content for the casts that follow; kept alive until the next call. Costs what is new by its serial.
  /// What cannot be measured (numbers that are not finite, triangles without area) is left out and counted,
  /// not an error. Errors: unavailable (memory, the device).
  [[nodiscard]] virtual Status prepare(std::shared_ptr<const ContentWindow> window) = 0;
  /// hits[i] belongs to rays[i]. A ray that is not finite meets nothing. Errors: bad_input (sizes, band,
  /// nothing prepared), unavailable.
  [[nodiscard]] virtual Status cast(const RayQuery& query, std::span<Hit> hits) = 0;
  /// What wide rays meet, as many as hits.rays(): surfaces with holes that cover a part of a ray take their
  /// share of it, and the rest goes on; any other surface that a ray's middle meets takes all that is left.
  /// Surfaces on the way cover independently of each other. What stands here is for engines without widths:
  /// it answers by cast(). Errors: as cast().
  [[nodiscard]] virtual Status cast_layers(const RayQuery& query, LayeredHits& hits) = 0;
  /// occluded[i] = 1 where anything stands between near and far of rays[i], else 0; of a ray that is not
  /// finite 0. An engine may count faces from behind too, where cast() does not see them. Errors: as cast().
  [[nodiscard]] virtual Status occluded(const RayQuery& query, std::span<std::uint8_t> occluded);
  [[nodiscard]] virtual EngineStatistics statistics() const = 0;

 private:
  std::vector<Hit> met_;  ///< by the engines that answer other questions by cast()
};

}  // namespace rigor::render
