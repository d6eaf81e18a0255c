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

enum class Mesh : std::uint8_t { box, cylinder, ground };

struct SurfaceDraw {
  Mesh mesh = Mesh::box;
  bool pattern = false;            ///< a body with a chessboard
  std::uint32_t data = 0;          ///< index into `surfaces`
  std::uint32_t casters = 0;       ///< how many bodies may shade it
  bool cylinders = false;          ///< among them
  std::uint32_t first_vertex = 0;  ///< ground: into `ground_vertices`
  std::uint32_t vertex_count = 0;
  double nearest_m = 0;
};

/// Reused from frame to frame: after the first frames it allocates nothing.
class FrameGeometry {
 public:
  /// The scene must be valid and outlive this object.
  FrameGeometry(const world::Scene& scene, const ChannelResponse& response);

  void build(const PictureGeometry& picture, const Eigen::Isometry3d& T_world_sensor,
             const world::WorldSnapshot& snapshot, BenchTime t);

  gpu::FrameUniforms uniforms;
  std::vector<SurfaceDraw> draws;  ///< bodies front to back, then the ground
  bool in_the_dark = false;        ///< the eye is within a closed, opaque body: there is nothing to see
  std::vector<gpu::SurfaceData> surfaces;
  std::vector<gpu::CasterData> casters;  ///< all bodies
  std::vector<std::uint32_t> caster_list;
  std::vector<gpu::GroundVertex> ground_vertices;

  /// Upper bounds of the lists above, for the sizes of buffers.
  [[nodiscard]] std::size_t max_tiles() const;
  [[nodiscard]] std::size_t max_surfaces() const { return scene_.bodies.size() + max_tiles(); }
  [[nodiscard]] std::size_t max_caster_list() const;
  /// Is there a glossy material, and sun on it?
  [[nodiscard]] bool bodies_have_highlights() const;
  [[nodiscard]] bool ground_has_highlights() const;

 private:
  struct Tile {
    std::uint32_t first_caster, casters;
    std::array<gpu::GroundVertex, 6> vertices;
  };
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
  void give_casters(gpu::SurfaceData& surface, SurfaceDraw& draw, std::uint32_t first,
                    std::uint32_t count) const;
  [[nodiscard]] bool sphere_visible(const Eigen::Vector3d& centre_camera, double radius_m) const;

  const world::Scene& scene_;
  std::vector<gpu::MaterialData> materials_;
  std::vector<Placed> placed_;
  std::vector<Tile> tiles_;
  std::vector<std::uint32_t> tile_order_;
  /// Where a body's shadow can fall on the ground: bounds, and its extent square to the sun's direction.
  struct Footprint {
    Eigen::AlignedBox2d box;
    Eigen::AlignedBox1d across;
  };
  std::vector<Footprint> footprints_;
  std::array<Eigen::Vector3d, 4> planes_;  ///< inward normals of the view's side planes, camera frame
  Eigen::Vector3d sun_camera_ = Eigen::Vector3d::UnitZ();
  bool sun_up_ = false;
};

}  // namespace rigor::render
