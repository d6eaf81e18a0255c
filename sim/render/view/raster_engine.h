// The Vulkan engine's answer to rays: what is seen from one point is drawn into views that hold range,
// normal, material, place on the texture, node and reflectance; the rays are then sampled from them. Cheap
// where many rays share an origin and an instant; rays of other origins in a query are answered as if they
// started at its origin.
//
// Which views: one where the rays lie in a cone of up to 100 degrees, else up to four sides about their axis,
// and top and bottom, each cut to what its rays use. A texel holds what its middle shows: identity, material
// and normal are those of the nearest texel, range is where the ray meets the plane of the texel's triangle.
// Errors: some 10 um and 20 ppm in range on surfaces that fill a texel; at silhouettes and on leaves smaller
// than texels, what stands up to half a texel beside the ray. Where the rays are the pixels of a pinhole and
// `pixels_per_rad` is its focal length, texels lie on the rays, and only levels of detail are left as an
// error. Impostors are never used.
#pragma once

#include <memory>

#include "sim/render/device.h"
#include "sim/render/engine/ray_engine.h"

namespace rigor::render {

struct RasterOptions {
  double pixels_per_rad = 500;  ///< of the views, at their centre: a camera's focal length in pixels
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

  [[nodiscard]] std::string_view name() const override { return "raster"; }
  [[nodiscard]] bool own_origins() const override { return false; }
  [[nodiscard]] Status prepare(std::shared_ptr<const ContentWindow> window) override;
  [[nodiscard]] Status cast(const RayQuery& query, std::span<Hit> hits) override;
  [[nodiscard]] Status cast_layers(const RayQuery& query, LayeredHits& hits) override {
    return RayEngine::cast_layers(query, hits);
  }
  [[nodiscard]] EngineStatistics statistics() const override;

  struct Impl;

 private:
  RasterEngine();
  std::unique_ptr<Impl> impl_;
};

}  // namespace rigor::render
