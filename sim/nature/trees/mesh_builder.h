// Puts a tree's wood and foliage together.
#pragma once

#include <Eigen/Geometry>
#include <memory>
#include <span>
#include <vector>

#include "sim/nature/trees/tree_textures.h"
#include "sim/render/content/content.h"

namespace rigor::nature {

using Vec3 = Eigen::Vector3f;

/// A point of a stem's axis.
struct StemPoint {
  Vec3 position;
  float radius;
  float sway;
};

class MeshBuilder {
 public:
  /// A tube along `path` (at least two points), open at its ends; `v_m` is where the bark's picture begins. A
  /// last radius of 0 closes it in a tip.
  void tube(std::span<const StemPoint> path, int sides, float bark_repeats, float v_m = 0);
  /// A flat card from `base` along `along` (its length), `half_width` to either side. The front looks along
  /// `up`, about; `normal` is the shading normal of base and tip.
  /// `part`: shows so much of the cell's picture, its tip.
  void card(const Vec3& base, const Vec3& along, const Vec3& up, float half_width, int cell,
            const Vec3& normal_base, const Vec3& normal_tip, float sway_base, float sway_tip, float part = 1);
  /// A bough: cards along `path` (StemPoint::radius: half width), folded like a roof by `fold_rad` down from
  /// the level on either side. `up` per point; shading normals per point.
  struct BoughPoint {
    Vec3 position, side, up, normal;
    float half_width, sway;
  };
  void bough(std::span<const BoughPoint> path, float fold_rad, int cell, bool mirrored = false);
  /// What foliage follows lies inside the crown (true) or on it.
  void set_inner(bool inner) { inner_now_ = inner; }
  /// Any triangle of wood.
  std::uint32_t wood_vertex(const Vec3& p, const Vec3& n, float u, float v, float sway);
  void wood_triangle(std::uint32_t a, std::uint32_t b, std::uint32_t c);

  [[nodiscard]] float leaf_area_m2() const { return leaf_area_m2_; }
  /// Of cards and boughs, by area: how wide what is drawn is flat.
  [[nodiscard]] float mean_half_width_m() const {
    return flat_area_m2_ > 0 ? flat_moment_m3_ / flat_area_m2_ : 0;
  }
  [[nodiscard]] std::size_t triangles() const { return (wood_.size() + inner_.size() + foliage_.size()) / 3; }
  /// Coverage of the atlas cells, for leaf_area_m2.
  void set_coverage(const std::array<float, 5>& coverage) { coverage_ = coverage; }
  /// Takes the mesh: wood, inner foliage, outer foliage. Parts without triangles are left out.
  [[nodiscard]] std::shared_ptr<const render::Mesh> finish(
      std::shared_ptr<const render::Surface> wood, std::shared_ptr<const render::Surface> foliage,
      std::shared_ptr<const render::Surface> inner = nullptr);

 private:
  std::uint32_t vertex(const Vec3& p, const Vec3& n, float u, float v, float sway);
  std::vector<render::Vertex> vertices_;
  std::vector<std::uint32_t> wood_, inner_, foliage_;
  bool inner_now_ = false;
  std::array<float, 5> coverage_{1, 1, 1, 1, 1};
  float leaf_area_m2_ = 0, flat_area_m2_ = 0, flat_moment_m3_ = 0;
};

/// Any unit vector square to `v`.
[[nodiscard]] inline Vec3 square_to(const Vec3& v) {
  return v.cross(std::abs(v.z()) < 0.9F * v.norm() ? Vec3(0, 0, 1) : Vec3(1, 0, 0)).normalized();
}

}  // namespace rigor::nature
