// What one picture of a small scene needs, worked out in double precision and rounded to float relative to
// the sensor: bodies and ground as the rays of the camera meet them, and for each body the short
// list of those that may stand between it and the sun. Internal to sim/render/scene.
#pragma once

#include <Eigen/Geometry>
#include <array>
#include <cstdint>
#include <vector>

#include "rt-core/time.h"
#include "sim/world/scene.h"

namespace rigor::render {

/// Nothing nearer along the optical axis is seen.
inline constexpr double kSceneNear_m = 0.01;

/// Electrons per second per unit of radiance, per output channel (mono uses the first) and band.
using ChannelResponse = std::array<world::Bands, 3>;
using Channels = std::array<float, 3>;

/// Electrons per second and channel that a matt surface of a material sends to a pixel on the axis:
/// sun cos(theta) visible + ambient_0 + ambient_1 (n . up).
struct SurfaceLight {
  Channels sun{}, ambient_0{}, ambient_1{};
  float roughness = 1;
};

/// The rays (u, v, 1) of the camera in another frame: origin + t (axis + u right + v down), where t is the
/// distance along the optical axis in metres.
struct FrameRays {
  float origin[3]{}, axis[3]{}, right[3]{}, down[3]{};
};

/// In its unit frame a box is [-1, 1]^3, a cylinder x² + y² <= 1, |z| <= 1.
struct FrameBody {
  bool cylinder = false;
  FrameRays rays;                                      ///< unit frame
  Eigen::Vector3f sun_unit = Eigen::Vector3f::Ones();  ///< direction to the sun in the unit frame; never 0
  Eigen::Vector3f half_size_m = sun_unit;
  Eigen::Vector3f sun = sun_unit, up = sun_unit;  ///< unit length, in the body's own axes
  const SurfaceLight* material = nullptr;
  const SurfaceLight* dark = nullptr;                 ///< of the chessboard on the +z face; null: none
  Eigen::Vector2f squares = Eigen::Vector2f::Zero();  ///< of the board, along x and y
  float squares_per_m = 0;
  Eigen::AlignedBox2f seen;                     ///< rays (u, v) that may meet it; empty: none
  std::uint32_t first_caster = 0, casters = 0;  ///< into SceneFrame::casters
};

/// Where a body's shadow can fall on the ground, and its extent square to the sun's direction; in the frame
/// of FrameGround.
struct Footprint {
  Eigen::AlignedBox2d box;
  Eigen::AlignedBox1d across;
};

/// x and y in cells from an even cell near the eye, z in metres: small numbers for float, the same pattern
/// anywhere.
struct FrameGround {
  FrameRays rays;
  Eigen::Vector2f least = Eigen::Vector2f::Zero(), most = least;  ///< cells
  std::array<std::int32_t, 2> base_cell{};                        ///< even
  float noise_contrast = 0;
  const SurfaceLight* material = nullptr;
  const SurfaceLight* other = nullptr;
  Eigen::Vector2d across = Eigen::Vector2d::UnitX();  ///< square to the sun's direction
  float cos_sun = 0;
};

/// Reused from frame to frame: after the first frames it allocates nothing.
class SceneFrame {
 public:
  /// The scene must be valid and outlive this object.
  SceneFrame(const world::Scene& scene, const ChannelResponse& response);

  /// `field`: of the rays (u, v) that will be asked for.
  void build(const Eigen::Isometry3d& T_world_sensor, const Eigen::AlignedBox2f& field,
             const world::WorldSnapshot& snapshot, BenchTime t);

  std::vector<FrameBody> bodies;  ///< all of the scene
  std::vector<std::uint32_t> casters;
  std::vector<Footprint> footprints;  ///< of bodies that may shade the ground
  std::vector<std::uint32_t> footprint_bodies;
  bool has_ground = false;
  FrameGround ground;
  bool in_the_dark = false;  ///< the eye is within a closed, opaque body: there is nothing to see
  bool sun_up = false;
  Eigen::Vector3d sun_camera = Eigen::Vector3d::UnitZ();  ///< direction to the sun
  Eigen::Vector3d up_camera = sun_camera;
  Channels sky_horizon{}, sky_gradient{}, below_horizon{};
  Channels sun_specular{};  ///< electrons per second and channel of the sun's irradiance, for highlights

 private:
  void place_bodies(const Eigen::Isometry3d& T_camera_world, const Eigen::AlignedBox2f& field,
                    const world::WorldSnapshot& snapshot, BenchTime t);
  void place_ground(const Eigen::Isometry3d& T_camera_world);

  const world::Scene& scene_;
  std::vector<SurfaceLight> materials_;
  std::vector<Eigen::Isometry3d> T_world_body_;
};

}  // namespace rigor::render
