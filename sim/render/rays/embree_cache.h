// Meshes as Embree has them, by serial. Internal to sim/render/rays.
#pragma once

#include <atomic>
#include <map>
#include <mutex>
#include <unordered_map>

#include "sim/render/rays/embree_engine.h"
#include "sim/render/rays/embree_scene.h"

namespace rigor::render {

/// A sphere that holds a prototype's finest level.
struct PrototypeSphere {
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  double radius_m = 0;
};

struct WantedBatch;

class MeshCache final : public EmbreeCache {
 public:
  explicit MeshCache(RTCDevice device);
  ~MeshCache() override;

  [[nodiscard]] RTCDevice device() const noexcept { return device_; }
  /// Never null. `built`: it was not there. Errors: unavailable. Any thread.
  [[nodiscard]] Result<std::shared_ptr<const RayMesh>> get(const std::shared_ptr<const Mesh>& mesh,
                                                           bool& built);
  /// Never null. Any thread.
  [[nodiscard]] std::shared_ptr<const RayBatch> get(const WantedBatch& wanted);
  [[nodiscard]] PrototypeSphere sphere(const Prototype& prototype);
  /// What Embree complained of since it was last asked; "" if nothing. Of this thread.
  [[nodiscard]] std::string complaint() const;

 private:
  /// What one thread makes while those who ask for the same wait, and those who ask for something else do
  /// not.
  template <class T>
  struct Slot {
    std::mutex making;
    std::weak_ptr<const T> made;
  };
  [[nodiscard]] std::shared_ptr<const LeafCover> cover(const std::shared_ptr<const Texture>& map,
                                                       float alpha_cutoff);
  [[nodiscard]] std::shared_ptr<const RaySurface> surface(const std::shared_ptr<const Surface>& surface);
  [[nodiscard]] Result<std::shared_ptr<const RayMesh>> build(const std::shared_ptr<const Mesh>& mesh);

  RTCDevice device_;
  std::mutex mutex_;
  std::size_t sweep_at_ = 1024, sweep_batches_at_ = 4096;
  std::unordered_map<std::uint64_t, std::shared_ptr<Slot<RayMesh>>> meshes_;
  std::unordered_map<std::uint64_t, std::vector<std::weak_ptr<const RayBatch>>> batches_;  ///< first serial
  std::unordered_map<std::uint64_t, std::weak_ptr<const RaySurface>> surfaces_;
  /// By the map's serial and the cutoff: surfaces share maps.
  std::map<std::pair<std::uint64_t, float>, std::shared_ptr<Slot<LeafCover>>> covers_;
  std::unordered_map<std::uint64_t, PrototypeSphere> spheres_;
};

}  // namespace rigor::render
