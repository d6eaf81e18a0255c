// From a window of content to Embree's instances. Internal to sim/render/rays.
#pragma once

#include <unordered_map>

#include "sim/render/rays/embree_cache.h"

namespace rigor::render {

/// A batch over the window, and which mesh each of its instances has.
struct WantedBatch {
  std::vector<const Batch*> frames;                    ///< one where it stands still, else one per frame
  std::vector<const Mesh*> choice;                     ///< by instance, or one for all; null: none
  std::vector<std::shared_ptr<const RayMesh>> meshes;  ///< those among them
  std::shared_ptr<const RayBatch> made;
};

/// What is to be placed, in the order of the content, whatever the cell. A version changes whenever what its
/// batches say may be another; batches of the same version may be other objects that say the same.
struct WantedContent {
  std::shared_ptr<const ContentWindow> window;
  std::vector<WantedBatch> still, moving;
  std::uint64_t still_version = 0, moving_version = 0;
};

/// Batches of a window: those that stand still, and what moves, with all its frames.
struct SplitWindow {
  std::vector<const Batch*> still;
  std::vector<WantedBatch> moving;
};
[[nodiscard]] SplitWindow split(const ContentWindow& window);

/// Never null. Of what has a structure of its own that too. Any thread.
[[nodiscard]] std::shared_ptr<const RayBatch> make_batch(RTCDevice device, const WantedBatch& wanted);

/// The scene of one cell, brought up to date by what differs from the last time.
class PlacedScene final : public RayScene {
 public:
  PlacedScene(std::shared_ptr<MeshCache> cache, const Eigen::Vector3d& origin);
  ~PlacedScene() override;
  /// Costs what changed since it was called last, in what stands still, and all that moves. Errors:
  /// unavailable.
  [[nodiscard]] Status place(const WantedContent& wanted);

 private:
  // What Embree asks of a batch with a structure of its own.
  static void bounds(const RTCBoundsFunctionArguments* a);
  static void intersect(const RTCIntersectFunctionNArguments* a);
  static void occluded(const RTCOccludedFunctionNArguments* a);
  template <unsigned N>
  static void intersect_rays(const RTCIntersectFunctionNArguments* a);
  template <unsigned N>
  static void occlude_rays(const RTCOccludedFunctionNArguments* a);
  template <unsigned N>
  struct Rays;
  struct Within;
  void attach(Level& level, Placed& p);
  static void detach(Level& level, Placed& p);
  void place(Level& level, const std::vector<WantedBatch>& batches);

  std::shared_ptr<MeshCache> cache_;
  std::uint64_t still_version_ = 0, moving_version_ = 0;
};

}  // namespace rigor::render
