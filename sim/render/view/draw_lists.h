// From visible instances to draw calls: the list of instances that the device puts in order, and calls sorted
// by state. Internal to sim/render/view.
#pragma once

#include <cstdint>
#include <span>
#include <unordered_map>
#include <vector>

#include "sim/render/view/culling.h"
#include "sim/render/view/view_pipelines.h"

namespace rigor::render {

struct DrawCall {
  VkPipeline pipeline = VK_NULL_HANDLE;
  VkPipeline depth_pipeline = VK_NULL_HANDLE;  ///< of its depth alone, where that is drawn first
  VkDescriptorSet set = VK_NULL_HANDLE;        ///< of the surface; none for casters without holes
  const ResidentMesh* mesh = nullptr;          ///< null: an impostor's four corners
  std::uint32_t first_index = 0, index_count = 0;
  std::uint32_t first_instance = 0, instance_count = 0;
  std::uint32_t named_surface = 0;  ///< of range views: number of the surface, from 1
  // What they are sorted by.
  std::uint32_t features = 0;
  std::uint64_t surface = 0, mesh_serial = 0;
  float distance_m = 0;
};

/// What the frame adds to the features of every surface.
struct FrameFeatures {
  std::uint32_t all = 0;  ///< multisampled, haze, lamps, shadows, wet, after depth, normals
  bool snow = false, sway = false, wet = false;
  bool instancing = true;
};

class DrawLists {
 public:
  DrawLists(const Device::Impl& gpu, ViewPipelines& pipelines) : gpu_(gpu), pipelines_(pipelines) {}

  /// So many a storage buffer holds.
  [[nodiscard]] std::size_t most_instances() const {
    return gpu_.limits.maxStorageBufferRange / sizeof(view_gpu::DrawnInstance);
  }
  /// Room for so many instances. Errors: unavailable (more than that).
  [[nodiscard]] Status begin(std::size_t instances);
  /// Calls for what the camera sees.
  [[nodiscard]] Result<std::vector<DrawCall>> add(const std::vector<Bucket>& buckets,
                                                  const Eigen::Vector3d& eye, const FrameFeatures& frame);
  /// Calls for range views: as above, with numbered surfaces, and no impostors.
  [[nodiscard]] Result<std::vector<DrawCall>> add_ranges(const std::vector<Bucket>& buckets,
                                                         const Eigen::Vector3d& eye,
                                                         const FrameFeatures& frame);
  /// Calls for what throws shadows, which lies relative to `middle`.
  [[nodiscard]] Result<std::vector<DrawCall>> add_casters(const std::vector<Bucket>& buckets,
                                                          const Eigen::Vector3d& middle,
                                                          const FrameFeatures& frame);
  /// Puts in order what was added since the last call.
  [[nodiscard]] Status record_gather(VkCommandBuffer commands, const ResidentContent& content);
  /// The calls inside a rendering; `frame_set` is bound by the caller.
  void record(VkCommandBuffer commands, std::span<const DrawCall> calls, bool instancing) const {
    record(commands, calls, instancing, false);
  }
  /// Of those that have one, the depth alone.
  void record_depth(VkCommandBuffer commands, std::span<const DrawCall> calls, bool instancing) const {
    record(commands, calls, instancing, true);
  }

  /// What the instance with this identity (from 1) is.
  [[nodiscard]] NodeId node(std::uint32_t identity) const {
    return identity >= 1 && identity <= nodes_.size() ? nodes_[identity - 1] : NodeId{};
  }

  /// The surface with this number (from 1); null where there is none.
  [[nodiscard]] const Surface* surface(std::uint32_t number) const {
    return number >= 1 && number <= surfaces_.size() ? surfaces_[number - 1] : nullptr;
  }

 private:
  [[nodiscard]] Result<std::vector<DrawCall>> add_seen(const std::vector<Bucket>& buckets,
                                                       const Eigen::Vector3d& eye, const FrameFeatures& frame,
                                                       ViewPass pass);
  void record(VkCommandBuffer commands, std::span<const DrawCall> calls, bool instancing,
              bool depth_only) const;
  void add_entries(const Bucket& bucket, const Eigen::Vector3d& eye, bool named);

  const Device::Impl& gpu_;
  ViewPipelines& pipelines_;
  vk::Buffer entries_, drawn_;
  vk::DescriptorPool pool_;
  std::size_t sets_ = 0;
  struct Pending {
    int block = 0;
    view_gpu::DrawEntry entry;
  };
  std::vector<Pending> pending_;
  std::uint32_t count_ = 0;    ///< entries so far
  std::uint32_t written_ = 0;  ///< of them in the buffer
  std::vector<NodeId> nodes_;
  std::vector<const Surface*> surfaces_;
  std::unordered_map<std::uint64_t, std::uint32_t> surface_numbers_;  // by serial; looked up, never walked
};

}  // namespace rigor::render
