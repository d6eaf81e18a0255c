// The engine of rays: Embree over the content that the Vulkan engine draws, with instancing, alpha-tested
// leaves and motion between the instants of a window. The reference that errors are measured against.
//
// Back faces of one-sided surfaces are not there for cast(), as they are not drawn: from inside a hull one
// sees out. For occluded() a face counts from both its sides, as for the Vulkan engine's shadows. Of surfaces
// in exactly one place the same one is met whenever content and query are the same. Plants do not sway: they
// stand as they do without wind. Maps are looked up bilinearly in their finest level. Ranges are worked out
// in double from the triangle that Embree found; positions are kept relative to a cell of 256 m round the
// query's origin, so that it does not matter where in the world it lies. Things without extent along one of
// their axes (a scale of 0) are left out.
#pragma once

#include <atomic>
#include <memory>

#include "sim/render/engine/ray_engine.h"

namespace rigor::render {

struct EmbreeOptions {
  /// A level of detail whose error subtends less than this at `eye` may stand for the finest. 0: always the
  /// finest.
  double allowed_error_rad = 0;
  Eigen::Vector3d eye = Eigen::Vector3d::Zero();
  double eye_reach_m = 0;  ///< … and at every place within this of `eye`
  int threads = 0;         ///< 0: all that the machine has
};

/// Acceleration structures of prototypes by serial, shared by the engines of a process. Any thread.
class EmbreeCache {
 public:
  [[nodiscard]] static Result<std::shared_ptr<EmbreeCache>> create();
  virtual ~EmbreeCache() = default;
};

/// CPU time of all threads in parts of an engine's work, summed up: for benches.
struct RayProfile {
  std::atomic<std::int64_t> prepare_ns{0};  ///< of the process during prepare()
  std::atomic<std::int64_t> walk_ns{0};     ///< in walks through the scene, holes of leaves included
};

class EmbreeEngine final : public RayEngine {
 public:
  /// Errors: unavailable.
  [[nodiscard]] static Result<std::shared_ptr<EmbreeEngine>> create(std::shared_ptr<EmbreeCache> cache,
                                                                    const EmbreeOptions& options = {});
  ~EmbreeEngine() override;
  /// For the prepares that follow.
  void set_options(const EmbreeOptions& options);
  /// Null, as at first: nothing is timed. Costs two reads of a clock for each packet of rays.
  void set_profile(std::shared_ptr<RayProfile> profile);

  [[nodiscard]] std::string_view name() const override { return "rays"; }
  [[nodiscard]] Status prepare(std::shared_ptr<const ContentWindow> window) override;
  [[nodiscard]] Status cast(const RayQuery& query, std::span<Hit> hits) override;
  /// occluded[i] = 1 where anything stands between origin and far_m.
  [[nodiscard]] Status cast_layers(const RayQuery& query, LayeredHits& hits) override;
  [[nodiscard]] Status occluded(const RayQuery& query, std::span<std::uint8_t> occluded) override;
  [[nodiscard]] EngineStatistics statistics() const override;
  [[nodiscard]] const ContentWindow* window() const noexcept;

  struct Impl;
  [[nodiscard]] Impl& impl() noexcept { return *impl_; }

 private:
  EmbreeEngine();
  std::unique_ptr<Impl> impl_;
};

}  // namespace rigor::render
