// The light that neighbouring pixels of a row see of one surface, and what stands between it and the sun.
// Internal to sim/render/scene.
#pragma once

#include <cmath>
#include <vector>

#include "sim/render/scene/scene_frame.h"

namespace rigor::render {

/// At most so many pixels at a time.
inline constexpr int kRunColumns = 64;

/// The rays of one row: origin + t (direction + u step).
struct RowRays {
  RowRays() = default;
  RowRays(const PixelRays& rays, int y) {
    const Eigen::Vector3d d = rays.axis + rays.row * y;
    for (int k = 0; k < 3; ++k) {
      origin[k] = static_cast<float>(rays.origin[k]);
      direction[k] = static_cast<float>(d[k]);
      step[k] = static_cast<float>(rays.column[k]);
    }
  }
  float origin[3]{}, direction[3]{}, step[3]{};
};

/// So that dividing by it gives a number.
inline float away_from_zero(float v) { return std::abs(v) < 1e-7f ? 1e-7f : v; }

/// Pixels next to each other that see the same face.
struct SceneRun {
  int first_column = 0, count = 0, padded_count = 0;
  const float* t = nullptr;  ///< distances along the optical axis, padded_count of them
  int channels = 1;
  std::array<float*, 3> out{};  ///< electrons per second, `count` of them for each channel
};

/// The bodies that may stand between a run and the sun, on one row.
class SceneShades {
 public:
  void clear() { shades_.clear(); }
  void add(const FrameBody& body, int y) {
    shades_.push_back(
        {RowRays(body.rays, y), {body.sun_unit.x(), body.sun_unit.y(), body.sun_unit.z()}, body.cylinder});
  }
  /// 1 where the sun is seen, else 0; padded_count of them.
  void sunlight(const SceneRun& run, float* lit) const;

  struct Shade {
    RowRays rays;
    float sun[3];
    bool cylinder;
  };

 private:
  std::vector<Shade> shades_;
};

void light_of_sky(const SceneFrame& frame, const RowRays& camera, const SceneRun& run);
void light_of_ground(const SceneFrame& frame, const RowRays& camera, const RowRays& ground,
                     const SceneShades& shades, const SceneRun& run);
/// `face`: 2 axis, + 1 on its positive side; a cylinder's side is 0.
void light_of_body(const SceneFrame& frame, const RowRays& camera, const FrameBody& body, int face, int y,
                   const SceneShades& shades, const SceneRun& run);

}  // namespace rigor::render
