#include "sim/render/view/culling.h"

#include <algorithm>
#include <cmath>
#include <unordered_map>

#include "sim/render/view/impostors.h"

namespace rigor::render {
namespace {

/// Buckets by prototype and level, in the order in which they first occur.
class Sorter {
 public:
  Bucket& at(const ResidentPrototype& p, std::size_t level, const ImpostorAtlas* impostor) {
    if (last_ != &p) {
      auto [it, fresh] = rows_.try_emplace(&p, rows_.size());
      if (fresh) of_.emplace_back(p.levels.size() + 1, -1);
      row_ = it->second;
      last_ = &p;
    }
    int& slot = of_[row_][impostor != nullptr ? p.levels.size() : level];
    if (slot < 0) {
      slot = static_cast<int>(buckets_.size());
      buckets_.push_back({&p, impostor != nullptr ? nullptr : p.levels[level], impostor, {}});
    }
    return buckets_[static_cast<std::size_t>(slot)];
  }
  std::vector<Bucket> take() { return std::move(buckets_); }

 private:
  std::unordered_map<const ResidentPrototype*, std::size_t> rows_;  // looked up, never walked
  std::vector<std::vector<int>> of_;
  std::vector<Bucket> buckets_;
  const ResidentPrototype* last_ = nullptr;
  std::size_t row_ = 0;
};

constexpr double kSunDiameter_rad = 0.0093;

bool drawable(const ResidentMesh* m) { return m != nullptr && !m->parts.empty(); }

}  // namespace

std::size_t level_for(const Prototype& p, double scale, double distance_m, double allowed_rad) {
  std::size_t best = 0;
  const double allowed_m = allowed_rad * std::max(distance_m, 0.0);
  for (std::size_t i = 1; i < p.levels.size(); ++i)
    if (p.levels[i].error_m * scale <= allowed_m) best = i;
  return best;
}

std::vector<Bucket> cull(const ViewCamera& camera, std::span<const ResidentBatch* const> batches,
                         const CullOptions& o) {
  Sorter sorter;
  const double allowed_rad = o.allowed_error_px / camera.focal_px;
  for (const ResidentBatch* b : batches) {
    const ResidentPrototype& p = *b->prototype;
    if (!(p.radius > 0)) continue;
    const double sway_m = p.prototype->sway_m * o.sway_factor;
    Seen batch_seen = o.frustum ? seen(camera, b->bounds, sway_m) : Seen::inside;
    if (batch_seen == Seen::outside) continue;
    const Eigen::Vector3f origin = (b->batch->origin - camera.eye).cast<float>();
    std::array<Eigen::Vector4f, 5> planes;
    for (std::size_t i = 0; i < 5; ++i) planes[i] = camera.planes[i].cast<float>();
    const bool test = batch_seen == Seen::partly;
    const bool one_level = p.levels.size() == 1 || !o.levels;
    for (std::uint32_t i = 0; i < b->spheres.size(); ++i) {
      const CullSphere& s = b->spheres[i];
      const Eigen::Vector3f c = origin + Eigen::Vector3f(s.x, s.y, s.z);
      const float radius = s.radius * 1.0001F + static_cast<float>(sway_m) * (s.radius / p.radius) + 1e-4F;
      if (test) {
        bool out = false;
        for (const Eigen::Vector4f& plane : planes) out = out || plane.head<3>().dot(c) + plane.w() < -radius;
        if (out) continue;
      }
      const float distance = c.norm();
      const double nearest = static_cast<double>(distance - s.radius);
      const double scale = static_cast<double>(s.radius / p.radius);
      const ImpostorAtlas* impostor = nullptr;
      if (o.impostors && p.prototype->impostor &&
          kImpostorErrorShare * static_cast<double>(s.radius) <= allowed_rad * nearest)
        impostor = o.impostor(p);
      const std::size_t level =
          one_level || impostor != nullptr ? 0 : level_for(*p.prototype, scale, nearest, allowed_rad);
      if (impostor == nullptr && !drawable(p.levels[level])) continue;
      sorter.at(p, level, impostor).instances.push_back({b, i, distance});
    }
  }
  return sorter.take();
}

bool shadow_moves(const ResidentBatch& b, const CullOptions& o) {
  return b.batch->moves || b.prototype->prototype->sway_m * o.sway_factor > 0;
}

std::vector<Bucket> cull_casters(const ShadowCascade& cascade, std::span<const ResidentBatch* const> batches,
                                 Casters which, const CullOptions& o, double smallest_m) {
  Sorter sorter;
  for (const ResidentBatch* b : batches) {
    const ResidentPrototype& p = *b->prototype;
    if (!p.prototype->casts_shadow || !(p.radius > 0)) continue;
    if (which != Casters::all && shadow_moves(*b, o) != (which == Casters::moving)) continue;
    const auto may_shade = [&](const Eigen::Vector3d& centre, double radius_m) {
      return which == Casters::still_in_square ? cascade.reaches(centre, radius_m)
                                               : cascade.may_shade(centre, radius_m);
    };
    if (!may_shade(b->bounds.center(), 0.5 * b->bounds.diagonal().norm())) continue;
    for (std::uint32_t i = 0; i < b->spheres.size(); ++i) {
      const CullSphere& s = b->spheres[i];
      const Eigen::Vector3d c = b->batch->origin + Eigen::Vector3d(s.x, s.y, s.z);
      const double sway_m = p.prototype->sway_m * o.sway_factor;
      if (2 * static_cast<double>(s.radius) < smallest_m) continue;
      if (!may_shade(c, s.radius + sway_m)) continue;
      const double scale = static_cast<double>(s.radius / p.radius);
      // What a shadow can tell apart: two texels, as wide as its edge is filtered; or the blur that the sun's
      // disc makes of an edge so far above.
      const double above_m = -cascade.z.dot(c - cascade.centre) - s.radius - cascade.half_side_m;
      const double distinguishable_m =
          o.allowed_error_px > 0
              ? std::max(2 * cascade.texel_m * o.allowed_error_px, kSunDiameter_rad * above_m)
              : 0.0;
      std::size_t level = 0;
      if (o.levels)
        for (std::size_t l = 1; l < p.levels.size(); ++l)
          if (p.prototype->levels[l].error_m * scale <= distinguishable_m) level = l;
      if (!drawable(p.levels[level])) continue;
      sorter.at(p, level, nullptr).instances.push_back({b, i, 0});
    }
  }
  return sorter.take();
}

void drop_hidden(const ViewCamera& camera, const DepthTiles& tiles, double sway_factor,
                 std::vector<Bucket>& buckets) {
  for (Bucket& bucket : buckets)
    std::erase_if(bucket.instances, [&](const Visible& v) {
      const CullSphere& s = v.batch->spheres[v.index];
      const Eigen::Vector3d c = v.batch->batch->origin - camera.eye + Eigen::Vector3d(s.x, s.y, s.z);
      const double radius = static_cast<double>(s.radius) * 1.0001 +
                            bucket.prototype->prototype->sway_m * sway_factor *
                                static_cast<double>(s.radius / bucket.prototype->radius);
      return tiles.hides(camera, c, radius);
    });
  std::erase_if(buckets, [](const Bucket& b) { return b.instances.empty(); });
}

void sort_by_distance(std::vector<Bucket>& buckets) {
  for (Bucket& b : buckets)
    std::stable_sort(b.instances.begin(), b.instances.end(),
                     [](const Visible& x, const Visible& y) { return x.distance_m < y.distance_m; });
}

}  // namespace rigor::render
