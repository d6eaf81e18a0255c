// What one picture of a scene needs, worked out on the CPU in double precision and handed to the GPU relative
// to the sensor in float: placed bodies (culled, front to back), tiles of the ground, and for each of them
// the short list of bodies that may stand between it and the sun. Internal to sim/render; no Vulkan here.
#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <vector>

#include "rt-core/time.h"
#include "sim/render/gpu_structs.h"
#include "sim/world/scene.h"

namespace rigor::render {

/// The pinhole picture that the lens samples from.
struct PictureGeometry {
  double focal_x_px = 0;
  double focal_y_px = 0;
  double centre_u_px = 0;  ///< pixel centres at integers
  double centre_v_px = 0;
  int width_px = 0;
  int height_px = 0;
};

/// Electrons per second per unit of radiance, per output channel (mono uses the first) and band.
using ChannelResponse = std::array<world::Bands, 3>;

struct BodyDraw {
  std::uint32_t instance = 0;
  world::Shape shape = world::Shape::box;
};

/// Reused from frame to frame: after the first frames it allocates nothing.
class FrameGeometry {
 public:
  /// The scene must be valid and outlive this object.
  FrameGeometry(const world::Scene& scene, const ChannelResponse& response);

  void build(const PictureGeometry& picture, const Eigen::Isometry3d& T_world_sensor,
             const world::WorldSnapshot& snapshot, BenchTime t);

  gpu::FrameUniforms uniforms;
  std::vector<gpu::MaterialData> materials;  ///< constant
  std::vector<gpu::BodyData> bodies;
  std::vector<BodyDraw> draws;  ///< front to back; instances index `bodies`
  bool in_the_dark = false;     ///< the eye is within a closed, opaque body: there is nothing to see
  std::vector<gpu::CasterData> casters;
  std::vector<std::uint32_t> caster_list;
  std::vector<gpu::TileData> tiles;
  std::vector<gpu::GroundVertex> ground_vertices;

  /// Upper bounds of the lists above, for the sizes of buffers.
  [[nodiscard]] std::size_t max_tiles() const;
  [[nodiscard]] std::size_t max_caster_list() const;
  [[nodiscard]] bool has_highlights() const;

 private:
  struct Placed {
    std::size_t body;
    Eigen::Isometry3d T_camera_body;
    Eigen::Isometry3d T_ground_body;
    Eigen::Vector3d centre_camera;
    double radius_m;
    double distance_m;
  };
  void place_bodies(const Eigen::Isometry3d& T_world_sensor, const world::WorldSnapshot& snapshot,
                    BenchTime t);
  void tile_ground(const Eigen::Isometry3d& T_camera_world);
  [[nodiscard]] bool sphere_visible(const Eigen::Vector3d& centre_camera, double radius_m) const;

  const world::Scene& scene_;
  std::vector<Placed> placed_;
  std::vector<Eigen::AlignedBox2d> footprints_;
  std::array<Eigen::Vector3d, 4> planes_;  ///< inward normals of the view's side planes, camera frame
  Eigen::Vector3d sun_camera_ = Eigen::Vector3d::UnitZ();
  bool sun_up_ = false;
};

}  // namespace rigor::render
