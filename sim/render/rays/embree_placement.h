// From a window of content to Embree's instances. Internal to sim/render/rays.
#pragma once

#include <unordered_map>

#include "sim/render/rays/embree_cache.h"

namespace rigor::render {

/// A batch over the window, and which mesh each of its instances has. Does not depend on a cell.
struct WantedBatch {
  std::vector<const Batch*> frames;  ///< one where it stands still, else one per frame
  /// By instance; null: left out. One element where all have the same.
  std::vector<const RayMesh*> meshes;
  [[nodiscard]] const RayMesh* mesh(std::size_t i) const { return meshes[meshes.size() == 1 ? 0 : i]; }
};

/// What is to be placed: by the order of the content.
struct WantedContent {
  std::shared_ptr<const ContentWindow> window;
  std::vector<WantedBatch> batches;
  std::unordered_map<std::uint64_t, std::shared_ptr<const RayMesh>> meshes;  ///< by serial: those in use
  std::size_t left_out = 0, triangles = 0;
};

/// Batches of a window: what is the same object in all frames once, what moves with all its frames.
[[nodiscard]] std::vector<WantedBatch> match_frames(const ContentWindow& window);

/// The scene of one cell, brought up to date by what differs from the last time.
class PlacedScene final : public RayScene {
 public:
  PlacedScene(std::shared_ptr<MeshCache> cache, const Eigen::Vector3d& origin);
  ~PlacedScene() override;
  /// Errors: unavailable.
  [[nodiscard]] Status place(const WantedContent& wanted);
  [[nodiscard]] std::size_t placed() const noexcept { return count_; }
  [[nodiscard]] std::size_t left_out() const noexcept { return left_out_; }

 private:
  struct Range {
    std::vector<std::uint64_t> serials;  ///< of the batch's frames
    std::vector<const RayMesh*> meshes;  ///< as they were placed
    std::uint32_t first = 0, count = 0, room = 0;
    std::uint32_t left_out = 0;
    [[nodiscard]] bool is(const WantedBatch& b) const;
  };
  void fill(const WantedBatch& batch, Range& range);
  void clear(const Range& range);
  void number_anew(const WantedContent& wanted);

  std::shared_ptr<MeshCache> cache_;
  std::vector<Range> ranges_;
  std::vector<RTCGeometry> geometries_;  ///< by instID; null: a gap
  std::vector<std::uint32_t> free_motions_;
  std::size_t count_ = 0, left_out_ = 0;
};

}  // namespace rigor::render
