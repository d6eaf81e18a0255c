// Meshes, prototypes and batches on the device: made once for each serial, kept as long as they are seen.
// Internal to sim/render/view.
#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <memory>
#include <unordered_map>
#include <vector>

#include "sim/render/view/gpu_arena.h"
#include "sim/render/view/texture_pool.h"

namespace rigor::render {

struct ResidentPart {
  std::uint32_t first_index = 0, index_count = 0;
  const ResidentSurface* surface = nullptr;
};
struct ResidentMesh {
  std::shared_ptr<const Mesh> mesh;
  Slice vertices, indices;
  std::vector<ResidentPart> parts;
  std::uint32_t triangles = 0;
  Eigen::AlignedBox3f bounds;  ///< of the vertices that are finite
  std::uint64_t last_seen = 0;
};

/// A sphere that holds an instance; relative to its batch's origin.
struct CullSphere {
  float x = 0, y = 0, z = 0, radius = 0;
};

struct ResidentPrototype {
  std::shared_ptr<const Prototype> prototype;
  std::vector<const ResidentMesh*> levels;
  Eigen::Vector3f centre = Eigen::Vector3f::Zero();
  float radius = 0;            ///< about the centre; 0: nothing to draw
  bool leaves = false;         ///< light shines through a part of it
  Eigen::AlignedBox3f bounds;  ///< of all levels
  std::uint64_t last_seen = 0;
};

struct ResidentBatch {
  std::shared_ptr<const Batch> batch;
  const ResidentPrototype* prototype = nullptr;
  Slice instances;
  std::uint32_t first_slot = 0;
  std::vector<CullSphere> spheres;
  std::vector<std::uint32_t> source;  ///< index into Batch::instances; empty: the same
  Eigen::AlignedBox3d bounds;         ///< of the spheres, world frame
  float low_m = 0, high_m = 0;        ///< of the prototype's box in all instances, relative to the origin
  std::uint32_t skipped = 0;
  std::uint64_t last_seen = 0;

  /// For what differs from instance to instance at random: of the instance alone, whatever else is drawn.
  [[nodiscard]] std::uint32_t seed(std::uint32_t i) const {
    const std::uint32_t s = source.empty() ? i : source[i];
    return static_cast<std::uint32_t>((node(i).value * 0x9E3779B97F4A7C15ULL + s * 0xD1B54A32D192ED03ULL) >>
                                      32);
  }
  [[nodiscard]] NodeId node(std::uint32_t i) const {
    const std::uint32_t s = source.empty() ? i : source[i];
    return s < batch->nodes.size() ? batch->nodes[s] : batch->node;
  }
};

class ResidentContent {
 public:
  ResidentContent(const Device::Impl& gpu, TexturePool& textures);

  /// Null where there is nothing to draw. The address holds until it is dropped.
  [[nodiscard]] Result<const ResidentBatch*> get(const std::shared_ptr<const Batch>& batch,
                                                 std::uint64_t frame);
  /// Frees what has not been seen since `frame`. No work that reads them may be under way.
  void drop_older_than(std::uint64_t frame);
  /// Blocks of instances: each is one storage buffer.
  [[nodiscard]] const GpuArena& instance_arena() const { return instances_; }
  [[nodiscard]] std::size_t take_uploaded_bytes() { return std::exchange(uploaded_bytes_, 0); }
  [[nodiscard]] std::size_t batches() const { return batches_.size(); }
  [[nodiscard]] std::size_t meshes() const { return meshes_.size(); }

 private:
  [[nodiscard]] Result<const ResidentMesh*> mesh(const std::shared_ptr<const Mesh>& mesh,
                                                 std::uint64_t frame);
  [[nodiscard]] Result<const ResidentPrototype*> prototype(const std::shared_ptr<const Prototype>& prototype,
                                                           std::uint64_t frame);

  TexturePool& textures_;
  GpuArena geometry_, instances_;
  std::size_t uploaded_bytes_ = 0;
  std::unordered_map<std::uint64_t, std::unique_ptr<ResidentMesh>> meshes_;
  std::unordered_map<std::uint64_t, std::unique_ptr<ResidentPrototype>> prototypes_;
  std::unordered_map<std::uint64_t, std::unique_ptr<ResidentBatch>> batches_;
};

}  // namespace rigor::render
