// What hides the sky, as the view engine guesses it (light.glsl: sky_seen): from a map of what stands highest
// round the eye, along a few azimuths. Costs a few texels a point and no rays. Internal to sim/render/rays.
//
// Places of the map stand still in the world. It is shot by rays from above, where it is new: the eye moved,
// or what casts shadows there changed.
#pragma once

#include <tbb/task_arena.h>

#include <memory>
#include <vector>

#include "sim/render/rays/embree_placement.h"
#include "sim/render/rays/light_shading.h"

namespace rigor::render::light {

class SkyCover {
 public:
  /// Brings the map up to date. `scene`: of the content. What it holds is a function of the scene and of the
  /// cell of the eye (kEyeCell_m), whatever it was shot of before.
  void update(const RayScene& scene, const WantedContent& content, const Eigen::Vector3d& eye,
              tbb::task_arena& arena);
  /// False where nothing rises above the ground, so that nothing hides the sky.
  [[nodiscard]] bool any() const noexcept { return rises_; }
  /// Share of the sky's light that a point gets, 0 to 1: of what its surface would get in the open (`sided`),
  /// or of all the sky (a leaf, lit on both sides). `p`: relative to the scene of the last update.
  [[nodiscard]] float seen(Vec3 p, Vec3 n, bool sided) const noexcept;

  /// What takes the place of the sky that is hidden: a share of it, and sunlight that leaves have scattered.
  struct Instead {
    Bands4 share{}, irradiance{};
  };
  [[nodiscard]] Instead instead(const LightFrame& light, const std::array<int, 4>& bands) const noexcept;

 private:
  /// What casts shadows, with its levels of detail.
  struct Caster {
    std::shared_ptr<const RayBatch> batch;
    Eigen::AlignedBox3d bounds;
    bool leaves = false;
  };
  /// By address.
  using Casters = std::vector<Caster>;
  /// From and to, in texels of the world; `to` is not in it.
  struct Area {
    std::int64_t x0 = 0, y0 = 0, x1 = 0, y1 = 0;
  };
  void shoot(const RayScene& scene, const Area& area, tbb::task_arena& arena);
  [[nodiscard]] static Area area_of(const Eigen::AlignedBox3d& box);
  [[nodiscard]] static Casters casters_of(const std::vector<WantedBatch>& batches);
  /// Takes over what casts shadows now; the areas in which that differs are stale.
  static void exchange(Casters& casters, Casters now, std::vector<Area>& stale);

  std::uint64_t still_version_ = 0, moving_version_ = 0;
  Casters still_, moving_;
  std::vector<float> top_m_;  ///< height in the world; a torus: texel (x, y) lies at x and y modulo its side
  std::int64_t x0_ = 0, y0_ = 0;
  bool filled_ = false, rises_ = false, leaves_ = false;
  Eigen::Vector3d origin_ = Eigen::Vector3d::Zero();  ///< of the scene
  float to_texel_x_ = 0, to_texel_y_ = 0, origin_z_ = 0;
};

}  // namespace rigor::render::light
