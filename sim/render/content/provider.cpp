#include "sim/render/content/provider.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace rigor::render {
namespace {
bool outside(const Eigen::Hyperplane<double, 3>& plane, const Eigen::AlignedBox3d& box, double reach_m) {
  Eigen::Vector3d farthest;
  for (int i = 0; i < 3; ++i) farthest[i] = plane.normal()[i] >= 0 ? box.max()[i] : box.min()[i];
  return plane.signedDistance(farthest) < -reach_m;
}
}  // namespace

void ContentQuery::look_from_cell_of(const Eigen::Vector3d& eye_world) {
  eye = eye_world;
  eye_reach_m = 0;
  if (!eye_world.allFinite()) return;
  for (double& x : eye) x = (std::floor(x / kEyeCell_m) + 0.5) * kEyeCell_m;
  eye_reach_m = kEyeCell_m / 2 * std::numbers::sqrt3;
}

double ContentQuery::distance_m(const Eigen::AlignedBox3d& box) const {
  return std::max(box.exteriorDistance(eye) - eye_reach_m, 0.0);
}

bool ContentQuery::may_see(const Eigen::AlignedBox3d& box) const {
  if (box.isEmpty() || distance_m(box) > far_m) return false;
  for (const auto& plane : frustum)
    if (outside(plane, box, eye_reach_m)) return false;
  return true;
}

bool ContentQuery::may_matter(const Eigen::AlignedBox3d& box) const {
  if (may_see(box)) return true;
  return !box.isEmpty() && shadow_reach_m > 0 && distance_m(box) <= shadow_reach_m;
}

}  // namespace rigor::render
