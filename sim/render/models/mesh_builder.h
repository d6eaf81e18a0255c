// Puts meshes together from flat faces, surface by surface; and the batches that show a mesh once or often.
#pragma once

#include <Eigen/Geometry>
#include <map>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "sim/render/content/content.h"

namespace rigor::render {

/// How a picture lies on a plane: u along `right`, v along `down` (rows of a Texture begin at the top), both
/// in repeats of the picture from `origin`.
struct PictureFrame {
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();
  Eigen::Vector3d right = Eigen::Vector3d::UnitX();  ///< length: repeats per metre
  Eigen::Vector3d down = -Eigen::Vector3d::UnitZ();
  [[nodiscard]] Eigen::Vector2d at(const Eigen::Vector3d& p) const {
    return {right.dot(p - origin), down.dot(p - origin)};
  }
};

/// Coordinates are the mesh's own, in metres. Faces without area are left out.
class MeshBuilder {
 public:
  using SurfacePtr = std::shared_ptr<const Surface>;
  /// Anticlockwise from outside; flat.
  void triangle(const SurfacePtr& surface, const Eigen::Vector3d& a, const Eigen::Vector3d& b,
                const Eigen::Vector3d& c, const PictureFrame& picture);
  /// As above, plane and convex.
  void polygon(const SurfacePtr& surface, std::span<const Eigen::Vector3d> corners,
               const PictureFrame& picture);
  /// A closed box; its picture is as wide as a metre on every face. `without`: a bit for each face that is
  /// left out, 1 << kTop.
  void box(const SurfacePtr& surface, const Eigen::Vector3d& min, const Eigen::Vector3d& max,
           unsigned without = 0);
  enum Face : unsigned { kLeft, kRight, kFront, kBack, kBottom, kTop };  // −x +x −y +y −z +z
  /// A closed cylinder or cone stump from z0 to z1 about the z axis, smooth outside. segments ≥ 3.
  struct Round {
    double z0_m = 0, z1_m = 1, radius0_m = 0.5, radius1_m = 0.5;
    int segments = 48;
  };
  void cylinder(const SurfacePtr& surface, const Round& round);
  /// Vertices with indices among themselves, as they are.
  void append(const SurfacePtr& surface, std::span<const Vertex> vertices,
              std::span<const std::uint32_t> indices);

  [[nodiscard]] bool empty() const noexcept { return groups_.empty(); }
  [[nodiscard]] std::size_t triangle_count() const noexcept;
  /// The parts stand in the order in which their surfaces were first used.
  [[nodiscard]] std::shared_ptr<const Mesh> finish() const;

 private:
  struct Group {
    SurfacePtr surface;
    std::vector<Vertex> vertices;
    std::vector<std::uint32_t> indices;
  };
  Group& group(const SurfacePtr& surface);
  std::vector<Group> groups_;
  std::map<const Surface*, std::size_t> index_;
};

/// World box of a batch from its prototype's finest level and its instances.
[[nodiscard]] Eigen::AlignedBox3d bounds_of(const Batch& batch);

/// One instance of a mesh of its own, with its origin at `origin`.
[[nodiscard]] std::shared_ptr<const Batch> single_batch(std::string name, NodeId node,
                                                        const Eigen::Vector3d& origin,
                                                        std::vector<LevelOfDetail> levels, bool occludes);

/// Rotation and translation of an isometry as an instance relative to `origin`.
[[nodiscard]] Instance instance_at(const Eigen::Isometry3d& T_world_instance, const Eigen::Vector3d& origin);

}  // namespace rigor::render
