// A small world for measuring light: materials by band, a ground plane, boxes and cylinders on moving nodes,
// one sun and a sky.
//
// What never changes during a run is the Scene; what moves is a WorldSnapshot, one JointMotion per node,
// valid over an interval of bench time. Poses are functions of time, so that every instant a sensor asks for
// (a tap, a row, a firing) has its own:
//
//   WorldSnapshot snapshot(scene);
//   snapshot.joints[turntable] = {t_ref, angle_rad, rate_rad_per_s};
//   Eigen::Isometry3d T_world_turntable = T_world_node(scene, snapshot, turntable, t);
//
// World frame: x east, y north, z up, metres. T_a_b maps b coordinates to a coordinates.
#pragma once

#include <Eigen/Geometry>
#include <array>
#include <cstddef>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "rt-core/result.h"
#include "rt-core/time.h"

namespace rigor::world {

/// A value per band: red, green, blue, near infrared (850 nm).
using Bands = std::array<double, 4>;

struct Material {
  std::string name{};
  Bands reflectance{0.5, 0.5, 0.5, 0.5};  ///< diffuse, 0 to 1
  double roughness = 1.0;  ///< 1: matt, no highlight; towards 0.05: gloss of a dielectric (GGX, F0 0.04)
};

/// Turns about an axis of the node's own frame, through its origin.
struct Hinge {
  Eigen::Vector3d axis = Eigen::Vector3d::UnitZ();  ///< unit length
};

struct Node {
  std::string name{};
  std::optional<std::size_t> parent{};  ///< index of an earlier node; empty: the world
  Eigen::Isometry3d T_parent_node = Eigen::Isometry3d::Identity();  ///< at joint angle 0
  std::optional<Hinge> hinge{};
};

/// angle(t) = angle_rad + rate_rad_per_s (t - t_ref) + acceleration_rad_per_s2 (t - t_ref)²/2. A node without
/// a hinge ignores it.
struct JointMotion {
  BenchTime t_ref;
  double angle_rad = 0.0;
  double rate_rad_per_s = 0.0;
  double acceleration_rad_per_s2 = 0.0;
  [[nodiscard]] double angle_at(BenchTime t) const noexcept {
    const double s = (t - t_ref).seconds();
    return angle_rad + s * (rate_rad_per_s + 0.5 * s * acceleration_rad_per_s2);
  }
};

enum class Shape : std::uint8_t { box, cylinder };

/// A chessboard on the body's +z face, centred. Its inner corners are numbered row by row as a reader sees
/// them who has x to the right and y up: corner (i, j) lies at ((i - (columns - 1)/2) square, ((rows - 1)/2 -
/// j) square, size_z/2) in the body's frame.
struct Chessboard {
  int columns = 9;  ///< inner corners along body x
  int rows = 6;     ///< inner corners along body y
  double square_m = 0.1;
  std::size_t dark_material = 0;  ///< the rest of the face has the body's material
};

struct Body {
  std::string name{};
  std::optional<std::size_t> node{};                              ///< empty: the world
  Eigen::Isometry3d T_node_body = Eigen::Isometry3d::Identity();  ///< origin at the body's centre
  Shape shape = Shape::box;
  Eigen::Vector3d size_m = Eigen::Vector3d::Ones();  ///< full lengths; a cylinder: diameter, diameter, height
  std::size_t material = 0;
  std::optional<Chessboard> chessboard{};  ///< boxes only
};

/// The plane z = 0 of its own frame, a square. Cells of two materials in turn, darkened by smooth noise.
struct Ground {
  Eigen::Isometry3d T_world_ground = Eigen::Isometry3d::Identity();
  double half_extent_m = 100.0;
  std::size_t material = 0;
  std::size_t other_material = 0;
  double cell_m = 1.0;
  double noise_contrast = 0.0;  ///< 0: flat; 0.5: reflectance between 0.5 and 1 times the material's
};

struct Sun {
  Eigen::Vector3d direction_to_sun =
      Eigen::Vector3d(0.4, -0.3, 0.866).normalized();  ///< world frame, unit length
  Bands irradiance_w_per_m2{0, 0, 0, 0};               ///< on a plane square to the sun, per band
};

/// Radiance between horizon and zenith, linear in the sine of the elevation.
struct Sky {
  Bands zenith_radiance_w_per_m2_sr{0, 0, 0, 0};
  Bands horizon_radiance_w_per_m2_sr{0, 0, 0, 0};
};

struct Scene {
  std::vector<Material> materials;
  std::vector<Node> nodes;
  std::vector<Body> bodies;
  std::optional<Ground> ground;
  Sun sun;
  Sky sky;

  /// Indices in range, unit vectors, positive sizes, parents before children. Setup.
  [[nodiscard]] Status validate() const;
};

/// Index of a node or body by its name; empty where there is none.
[[nodiscard]] std::optional<std::size_t> find_node(const Scene& scene, std::string_view name);
[[nodiscard]] std::optional<std::size_t> find_body(const Scene& scene, std::string_view name);

/// The moving part of a world. Copying into one of the same scene does not allocate.
struct WorldSnapshot {
  WorldSnapshot() = default;
  /// Every joint at angle 0 and at rest.
  explicit WorldSnapshot(const Scene& scene) : joints(scene.nodes.size()) {}
  std::vector<JointMotion> joints;  ///< one per node of the scene
};

/// Pose of a node (empty: the world itself) at an instant. Any thread, no allocation.
/// Precondition: the snapshot belongs to the scene, the scene is valid.
[[nodiscard]] Eigen::Isometry3d T_world_node(const Scene& scene, const WorldSnapshot& snapshot,
                                             std::optional<std::size_t> node, BenchTime t);
[[nodiscard]] Eigen::Isometry3d T_world_body(const Scene& scene, const WorldSnapshot& snapshot,
                                             std::size_t body, BenchTime t);

/// Inner corners of a body's chessboard in the body's frame, row by row. Empty where it has none. Allocates.
[[nodiscard]] std::vector<Eigen::Vector3d> chessboard_corners_in_body(const Body& body);

}  // namespace rigor::world
