// The Vulkan engine's answer to rays: what is seen from one point is drawn into views that hold range,
// normal, material, place on the texture, node and reflectance; the rays are then sampled from them. Cheap
// where many rays share an origin and an instant; rays of other origins in a query are answered as if they
// started at its origin.
#pragma once

#include <memory>

#include "sim/render/device.h"
#include "sim/render/engine/ray_engine.h"

namespace rigor::render {

struct RasterOptions {
  double pixels_per_rad = 500;  ///< of the views, at their centre
  double allowed_error_rad = 1e-3;
  /// Instants drawn per window where something moves: a ray takes the nearest.
  int instants = 1;
};

class RasterEngine final : public RayEngine {
 public:
  /// Errors: unavailable.
  [[nodiscard]] static Result<std::shared_ptr<RasterEngine>> create(std::shared_ptr<Device> device,
                                                                    const RasterOptions& options = {});
  ~RasterEngine() override;
  void set_options(const RasterOptions& options);

  [[nodiscard]] std::string_view name() const override { return "vulkan"; }
  [[nodiscard]] Status prepare(std::shared_ptr<const ContentWindow> window) override;
  [[nodiscard]] Status cast(const RayQuery& query, std::span<Hit> hits) override;
  [[nodiscard]] EngineStatistics statistics() const override;

  struct Impl;

 private:
  RasterEngine();
  std::unique_ptr<Impl> impl_;
};

}  // namespace rigor::render
