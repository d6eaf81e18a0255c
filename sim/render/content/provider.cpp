#include "sim/render/content/provider.h"

namespace rigor::render {
namespace {
bool outside(const Eigen::Hyperplane<double, 3>& plane, const Eigen::AlignedBox3d& box) {
  Eigen::Vector3d farthest;
  for (int i = 0; i < 3; ++i) farthest[i] = plane.normal()[i] >= 0 ? box.max()[i] : box.min()[i];
  return plane.signedDistance(farthest) < 0;
}
}  // namespace

bool ContentQuery::may_see(const Eigen::AlignedBox3d& box) const {
  if (box.isEmpty() || box.squaredExteriorDistance(eye) > far_m * far_m) return false;
  for (const auto& plane : frustum)
    if (outside(plane, box)) return false;
  return true;
}

bool ContentQuery::may_matter(const Eigen::AlignedBox3d& box) const {
  if (may_see(box)) return true;
  return !box.isEmpty() && shadow_reach_m > 0 &&
         box.squaredExteriorDistance(eye) <= shadow_reach_m * shadow_reach_m;
}

}  // namespace rigor::render
