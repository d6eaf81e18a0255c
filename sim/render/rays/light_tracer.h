// Light along rays: what a point on a camera's sensor collects through one point of its lens at one instant.
// The `rays` engine's answer to a picture: sun with shadow rays, sky light with what hides the sky, lamps,
// light through leaves, mirrors of gloss, haze and rain, as sim/render/view draws them.
#pragma once

#include <array>
#include <memory>

#include "sim/render/rays/embree_engine.h"

namespace rigor::render {

struct LightQuery {
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();  ///< world frame
  std::array<int, 4> bands{0, 1, 2, 3};              ///< index of world::kBandWavelength_nm
  float near_m = 0.001F;
  std::span<const Ray> rays;
  bool shadows = true;
  int sky_rays = 0;  ///< rays per sample that ask which sky is hidden; 0: the open sky of the normal's side
  std::uint64_t seed = 0;  ///< keys their directions, with the ray's index
};

struct LightSample {
  float radiance[4]{};  ///< of LightQuery::bands, W/(m² sr)
  float range_m = std::numeric_limits<float>::infinity();
  float normal[3]{};
  NodeId node{};
};

class LightTracer {
 public:
  /// Measures in what `engine` has prepared.
  explicit LightTracer(std::shared_ptr<EmbreeEngine> engine);
  ~LightTracer();
  /// samples[i] belongs to rays[i]. Same query, same samples, on any number of threads. Errors: bad_input.
  [[nodiscard]] Status trace(const LightQuery& query, std::span<LightSample> samples);

  struct Impl;

 private:
  std::unique_ptr<Impl> impl_;
};

}  // namespace rigor::render
