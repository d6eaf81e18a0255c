// What a world looks like to an engine: engine-neutral meshes, instances, materials, light and air.
//
// Everything here is immutable once it is shared: an engine keeps what it made of an object (a buffer, a
// texture, a BVH) under the object's `serial` for as long as it sees the object. A provider that wants a
// change makes a new object; what stays the same object costs nothing. So a tree that is felled costs its
// batch and not the forest.
//
// World frame: x east, y north, z up, metres. Positions are double in the world and float relative to a
// batch.
#pragma once

#include <Eigen/Geometry>
#include <array>
#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "sim/world/graph/value.h"
#include "sim/world/semantic_types.h"

namespace rigor::render {

using world::kBandCount;
using world::NodeId;
/// A value per band: red, green, blue, 850, 905, 1550 nm.
using Spectrum = std::array<float, kBandCount>;

/// Counts up; never 0. Any thread.
[[nodiscard]] std::uint64_t next_serial() noexcept;
/// make(0) … make(count - 1), on several threads. Serials are in the order of the numbers, whichever thread
/// was first, as long as one call of `make` takes no more than a million of them, and calls
/// neither this nor what makes things for all at its first call. What `make` throws, the
/// first by number, is thrown when all are done.
void make_in_parallel(std::size_t count, const std::function<void(std::size_t)>& make);

/// A picture on a surface. Rows from the top; four channels a texel.
struct Texture {
  std::uint64_t serial = next_serial();
  std::uint32_t width = 0, height = 0;
  bool srgb = true;                ///< red, green, blue are encoded in sRGB; off: linear
  bool repeat = true;              ///< off: clamped at the edges
  std::vector<std::uint8_t> rgba;  ///< alpha: coverage
};

/// How a surface reflects. Reflectance of band b at a point = reflectance[b] · factor, where the factor is
/// the colour map's red, green, blue for these bands and the near-infrared map's red, green, blue for 850,
/// 905, 1550 nm (where there is none: the colour map's mean of red, green and blue).
struct Surface {
  std::uint64_t serial = next_serial();
  std::string name{};
  Spectrum reflectance{0.5F, 0.5F, 0.5F, 0.5F, 0.5F, 0.5F};
  Spectrum transmittance{};  ///< diffuse, through a leaf: lit from behind it glows
  float roughness = 1.0F, metallic = 0.0F, retro_reflection = 0.0F;
  std::shared_ptr<const Texture> colour_map{}, near_infrared_map{}, normal_map{}, gloss_map{};
  float alpha_cutoff = 0.0F;  ///< above 0: texels with less coverage are not there
  bool two_sided = false;
  bool takes_snow = true;  ///< lying snow whitens what faces up
  float porosity = 0.5F;   ///< how much it darkens when wet (0: glass, 1: soil)
  bool water = false;      ///< mirrors the sky (Fresnel, index 1.33) above its diffuse part
};

struct Vertex {
  float position[3];
  float normal[3];
  float uv[2];
  float sway;  ///< 0 stiff … 1 moves with the wind by the prototype's `sway_m`
};
static_assert(sizeof(Vertex) == 36);

struct MeshPart {
  std::uint32_t first_index = 0, index_count = 0;
  std::shared_ptr<const Surface> surface;
};
struct Mesh {
  std::uint64_t serial = next_serial();
  std::vector<Vertex> vertices;
  std::vector<std::uint32_t> indices;  ///< triangles, anticlockwise from outside
  std::vector<MeshPart> parts;
  Eigen::AlignedBox3f bounds;
};

/// One level of detail. An engine may use it where `error_m` (times the instance's scale) subtends less than
/// the error that is allowed.
struct LevelOfDetail {
  std::shared_ptr<const Mesh> mesh;
  float error_m = 0.0F;  ///< largest deviation from the finest level, at scale 1
};

struct Prototype {
  std::uint64_t serial = next_serial();
  std::string name{};
  std::vector<LevelOfDetail> levels;  ///< finest first, at least one
  bool impostor =
      false;  ///< far away a picture of it may stand for it (an engine bakes it from the finest level)
  bool casts_shadow = true;
  bool occludes = false;  ///< solid and large: what lies behind it need not be drawn
  float sway_m = 0.0F;    ///< of a vertex of sway 1 at 10 m/s wind
};

struct Instance {
  float position[3]{};            ///< relative to Batch::origin
  float rotation[4]{0, 0, 0, 1};  ///< unit quaternion x y z w
  float scale[3]{1, 1, 1};        ///< along the prototype's axes, applied first
  float tint[3]{1, 1, 1};         ///< multiplies red, green, blue; their mean multiplies the near infrared
  float phase = 0;                ///< of its sway, rad
};

/// Instances of one prototype near each other: the unit in which content changes and is culled.
struct Batch {
  std::uint64_t serial = next_serial();
  std::shared_ptr<const Prototype> prototype;
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();
  std::vector<Instance> instances;
  std::vector<NodeId> nodes{};  ///< what each instance is in the world; empty: `node` for all
  NodeId node{};
  Eigen::AlignedBox3d bounds{};  ///< of all instances with their meshes, world frame
  bool moves = false;            ///< in motion at the instant that was asked for
};

/// Radiance of the upper half of the sky, without the sun's disc. Texel (i, j): azimuth (i + ½)·360°/width
/// from north over east, elevation (j + ½)·90°/height from the horizon up. W/(m² sr) per band.
struct SkyMap {
  std::uint64_t serial = next_serial();
  int width = 0, height = 0;
  std::vector<Spectrum> radiance;
  [[nodiscard]] Spectrum at(
      const Eigen::Vector3d& direction) const;  ///< bilinear; below the horizon: the horizon
};

struct Light {
  Eigen::Vector3d direction_to_sun{0, 0, 1};  ///< unit length; below the horizon: no sun
  Spectrum sun_irradiance{};                  ///< W/m² per band on a plane square to it, at the ground
  float sun_angular_radius_rad = 0.00465F;
  std::shared_ptr<const SkyMap> sky;                           ///< never null in a complete frame
  Spectrum ground_albedo{0.2F, 0.2F, 0.2F, 0.3F, 0.3F, 0.3F};  ///< for light from below the horizon
};
struct PointLight {
  Eigen::Vector3d position = Eigen::Vector3d::Zero();
  Spectrum radiant_intensity{};  ///< W/sr
};

/// Air that takes light away and puts its own in its place. Extinction below `top_m`; a ray's transmittance
/// in band b is exp(−extinction_per_m[b] · length below the top).
struct Haze {
  Spectrum extinction_per_m{};
  double top_m = std::numeric_limits<double>::infinity();
  Spectrum inscattered_radiance{};  ///< of an infinitely long way through it, W/(m² sr)
};

struct Precipitation {
  enum class Kind : std::uint8_t { none, rain, snow } kind = Kind::none;
  float drops_per_m3 = 0, diameter_m = 0;     ///< of those that are drawn
  Eigen::Vector3f velocity_m_per_s{0, 0, 0};  ///< wind included
  Spectrum extinction_per_m{};                ///< of all drops together
};

/// Reflectance of settled snow (Warren 1982, Wiscombe and Warren 1980): bright until water ice absorbs.
inline constexpr Spectrum kSnowReflectance{0.92F, 0.93F, 0.94F, 0.87F, 0.83F, 0.12F};
struct SurfaceState {
  float wetness = 0;       ///< 0 dry … 1 wet
  float snow_depth_m = 0;  ///< lying
};
struct Wind {
  Eigen::Vector3f velocity_m_per_s{0, 0, 0};
};

/// All that an engine draws for one query. Providers add to it.
struct ContentFrame {
  std::vector<std::shared_ptr<const Batch>> batches;
  Light light;
  std::vector<PointLight> lamps;
  std::vector<Haze> hazes;
  Precipitation precipitation;
  SurfaceState surface;
  Wind wind;
};

}  // namespace rigor::render
