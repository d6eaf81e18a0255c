// What hides the sky, as the view engine guesses it (light.glsl: sky_seen): from a map of what stands highest
// round the eye, along a few azimuths. Costs a few texels a point and no rays. Internal to sim/render/rays.
//
// Places of the map stand still in the world. It is shot by rays from above, block by block where somebody
// looks at it first, and again where what casts shadows there changed.
#pragma once

#include <atomic>
#include <memory>
#include <vector>

#include "sim/render/rays/embree_placement.h"
#include "sim/render/rays/light_shading.h"

namespace rigor::render::light {

class SkyCover {
 public:
  /// Brings the map up to date. `scene`: of the content. What it holds is a function of the scene and of the
  /// cell of the eye (kEyeCell_m), whatever it was shot of before.
  void update(const RayScene& scene, const WantedContent& content, const Eigen::Vector3d& eye);
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
  /// Of a block of texels.
  enum class State : std::uint8_t { stale, busy, known };
  /// Height of what stands highest at a texel. Any thread.
  [[nodiscard]] float top_m(std::int64_t x, std::int64_t y) const noexcept;
  /// Shoots the block of a texel, or waits for who does.
  void shoot(std::int64_t x, std::int64_t y) const noexcept;
  [[nodiscard]] static Area area_of(const Eigen::AlignedBox3d& box);
  [[nodiscard]] static Casters casters_of(const std::vector<WantedBatch>& batches);
  /// Takes over what casts shadows now; the areas in which that differs are stale.
  static void exchange(Casters& casters, Casters now, std::vector<Area>& stale);

  std::uint64_t still_version_ = 0, moving_version_ = 0;
  Casters still_, moving_;
  /// Height in the world; a torus: texel (x, y) lies at x and y modulo its side.
  mutable std::vector<float> top_m_;
  std::unique_ptr<std::atomic<State>[]> blocks_;
  const RayScene* scene_ = nullptr;
  std::int64_t x0_ = 0, y0_ = 0;
  bool filled_ = false, rises_ = false, leaves_ = false;
  Eigen::Vector3d origin_ = Eigen::Vector3d::Zero();  ///< of the scene
  float to_texel_x_ = 0, to_texel_y_ = 0, origin_z_ = 0;
};

}  // namespace rigor::render::light
