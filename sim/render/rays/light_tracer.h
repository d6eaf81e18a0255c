// Light along rays: what a point on a camera's sensor collects through one point of its lens at one instant.
// The `rays` engine's answer to a picture: sun with shadow rays, sky light with what hides the sky, lamps,
// light through leaves, mirrors of gloss, haze and rain, as sim/render/view draws them.
//
//   LightTracer tracer(engine);                        // an EmbreeEngine that has prepared a window
//   tracer.trace({.origin = p_world, .rays = rays, .sky_rays = 4}, samples);
//
// What it takes for granted:
// - A shadow ray is stopped by whatever casts shadows, leaves included, and passes their holes. Light that
//   leaves let through goes on as diffuse light: it is seen on the leaf that is lit from behind, and
//   elsewhere through `sky_rays` with `bounces`.
// - Without sky rays, what the surroundings send is gathered at one in 32 points and shared with those near
//   them, so that shade has no detail finer than about forty pixels; mirrors show the sky alone, as bright
//   as that says. Without `gather`, all of the sky and of the ground lights a surface, whatever stands around
//   it.
// - Lamps throw shadows (in the view engine they do not) and light directly: their light is not followed
//   through reflections. Retro-reflectors send the light of lamps back within half a degree.
// - Drops and flakes dim and veil; single ones are not seen. Plants stand still in the wind.
#pragma once

#include <array>
#include <memory>

#include "sim/render/rays/embree_engine.h"

namespace rigor::render {

/// Shadow rays to the sun: to the middle of its disc; to a point of it by seed and index; or to its middle,
/// but as wide as the disc, so that leaves let through the share of the light that they do not cover. Where
/// leaves shade a surface that stands still, `wide` has one answer for a cell of it about three pixels
/// (`spread_rad`) wide, which is kept from query to query; elsewhere the ray begins as wide as a pixel.
enum class SunRays : std::uint8_t { to_middle, to_points, wide };

struct LightQuery {
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();  ///< world frame
  std::array<int, 4> bands{0, 1, 2, 3};              ///< index of world::kBandWavelength_nm
  float near_m = 0.001F;
  std::span<const Ray> rays;
  bool shadows = true;
  int sky_rays = 0;        ///< rays per sample that ask which sky is hidden; 0: see `gather`
  std::uint64_t seed = 0;  ///< keys their directions, with the ray's number
  std::span<const std::uint32_t> numbers{};  ///< of the rays; empty: their indices
  /// Reflections that a sky ray follows at most, for chance ends it earlier: light of sun and sky from what
  /// hides the sky. 0: that is black.
  int bounces = 1;
  SunRays sun_rays = SunRays::to_middle;
  /// Angle between neighbouring rays: maps are taken as coarse as that sees them. 0: their finest texels.
  float spread_rad = 0;
  /// Without sky rays, and with shadows: surfaces have the light that the last gather() found near them.
  bool gathered = false;
  /// Eight rays at a time, from the first on, are of neighbouring pixels: where all eight of them meet one
  /// plane, sky and surroundings are worked out for three of the points and interpolated for the others. A
  /// sample then depends on the others of its eight. A third less time indoors.
  bool packets = false;
  /// Rays ask for the sky alone, each as wide as `spread_rad`: LightSample has the share of its width that is
  /// sky, and the sky's radiance, or a range of 0 where none of it is sky. What share of a pixel is sky costs
  /// a part of what its light costs.
  bool sky_only = false;
};

struct LightSample {
  float radiance[4]{};  ///< of LightQuery::bands, W/(m² sr)
  float range_m = std::numeric_limits<float>::infinity();
  float normal[3]{};
  NodeId node{};
  /// 1 where the ray meets nothing, else 0. With LightQuery::sky_only the share of the ray's width that
  /// leaves leave free, and 0 where a surface without holes stands or less than a twentieth is free.
  float sky_share = 0;
};

struct LightStatistics {
  std::size_t rays = 0, shadow_rays = 0,
              sky_rays = 0;  ///< shot by the last call; sky: with their shadow rays
  /// Sectors of the sphere that the last gather() did not find kept; and those that it asked for what moves.
  std::size_t gathered_sectors = 0, moved_sectors = 0;
};

/// Pixels of which one gathers light for all of them.
constexpr int kGatherWidth_px = 8, kGatherHeight_px = 4;
/// Which one of a block's, by its row and column of the picture.
struct GatheringPixel {
  int u = 0, v = 0;
};
[[nodiscard]] GatheringPixel gathering_pixel(int block_column, int block_row) noexcept;

class LightTracer {
 public:
  /// Measures in what `renderer` has prepared.
  explicit LightTracer(std::shared_ptr<EmbreeEngine> engine);
  ~LightTracer();
  /// Gathers the light of sky and surroundings about what lies in the directions of the rays, which start at
  /// the query's origin or near it, for queries with `gathered`. A few thousand rays over a picture will do.
  /// What stands still is gathered from places all over a cell of 1 m around the origin, and kept: it is a
  /// function of that cell, of the directions, of what stands there and of sun and sky, never of the query's
  /// seed or of what was asked before, so that cameras which see the same have the same error. What is
  /// gathered anew because something that moves is in the way is kept while that stands where it is. Same
  /// rays, same light, on any number of threads. Errors: bad_input, unavailable.
  [[nodiscard]] Status gather(const LightQuery& query);
  /// samples[i] belongs to rays[i]. Same query, same samples, on any number of threads. A ray that is not
  /// finite brings nothing. One thread at a time, engine included. Queries with SunRays::wide keep up to 32
  /// MiB of sunlight. Errors: bad_input, unavailable (memory).
  [[nodiscard]] Status trace(const LightQuery& query, std::span<LightSample> samples);
  [[nodiscard]] LightStatistics statistics() const noexcept;

  struct Impl;

 private:
  std::unique_ptr<Impl> impl_;
};

}  // namespace rigor::render
