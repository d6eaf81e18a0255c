// The light that neighbouring rays bring from one surface, and what stands between it and the sun.
// Internal to sim/render/scene.
#pragma once

#include <cmath>
#include <vector>

#include "sim/render/scene/lens_rays.h"
#include "sim/render/scene/scene_frame.h"

namespace rigor::render {

/// At most so many rays at a time.
inline constexpr int kRunRays = kRayPadding;

/// So that dividing by it gives a number.
inline float away_from_zero(float v) { return std::abs(v) < 1e-7f ? 1e-7f : v; }

/// Neighbouring rays that meet the same face.
struct SceneRun {
  RayRow rays;  ///< count of them; loops go to padded_count
  int padded_count = 0;
  const float* t = nullptr;  ///< distances along the optical axis, padded_count of them
  float* lit = nullptr;      ///< written: 1 where the sun is seen, else 0; padded_count of them
  int channels = 1;
  std::array<float*, 3> out{};  ///< electrons per second, `count` of them for each channel
};

/// The bodies that may stand between a run and the sun.
class SceneShades {
 public:
  void clear() { shades_.clear(); }
  void add(const FrameBody& body) {
    shades_.push_back({body.rays, {body.sun_unit.x(), body.sun_unit.y(), body.sun_unit.z()}, body.cylinder});
  }
  /// Fills run.lit.
  void sunlight(const SceneRun& run) const;

  struct Shade {
    FrameRays rays;
    float sun[3];
    bool cylinder;
  };

 private:
  std::vector<Shade> shades_;
};

void light_of_sky(const SceneFrame& frame, const SceneRun& run);
void light_of_ground(const SceneFrame& frame, const SceneShades& shades, const SceneRun& run);
/// `face`: 2 axis, + 1 on its positive side; a cylinder's side is 0.
void light_of_body(const SceneFrame& frame, const FrameBody& body, int face, const SceneShades& shades,
                   const SceneRun& run);

}  // namespace rigor::render
