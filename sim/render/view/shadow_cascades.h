// Shadow maps of the sun in cascades: each a square about a slice of the view. Squares are larger than their
// slices and move in steps, on texels that stand still in the world: while the eye moves within a step, what
// stands still throws the same shadows (kept_shadow.h). Internal to sim/render/view.
#pragma once

#include <Eigen/Geometry>
#include <vector>

#include "sim/render/view/view_camera.h"

namespace rigor::render {

struct ShadowCascade {
  // Axes of the map in the world: x and y across the light, z away from the sun.
  Eigen::Vector3d x, y, z;
  Eigen::Vector3d centre;  ///< world frame
  double half_side_m = 1;  ///< of the square
  double texel_m = 1;
  double near_m = 0, far_m = 1;  ///< along z from the centre
  double view_depth_m = 0;       ///< up to which it serves; of a zenith map: the larger of the ways from
                                 ///< the eye to east or west and to north or south
  double receivers_far_m = 1;    ///< along z from the centre: what lies wholly beyond shades nothing
  /// The outline of what it serves, in the plane of x and y relative to the centre: n·p ≤ d outwards.
  std::vector<Eigen::Vector3d> outline;

  /// May a sphere throw a shadow into the map's square?
  [[nodiscard]] bool reaches(const Eigen::Vector3d& p_world, double radius_m) const;
  /// And into the part of it that is looked at?
  [[nodiscard]] bool may_shade(const Eigen::Vector3d& p_world, double radius_m) const;
  [[nodiscard]] view_gpu::CascadeData data(int side_px, const Eigen::Vector3d& eye_world) const;
};

struct ShadowSettings {
  int side_px = 1024;
  double reach_m = 400;  ///< view depth of the last cascade's end
};
/// Texels along a side that suit a picture.
[[nodiscard]] int shadow_side_px(const Pinhole& pinhole, std::uint32_t limit_px);
/// `content`: all that is drawn or throws shadows, relative to the eye; it bounds depths and reach.
[[nodiscard]] std::vector<ShadowCascade> shadow_cascades(const ViewCamera& camera,
                                                         const Eigen::Vector3d& to_sun,
                                                         const Eigen::AlignedBox3d& content,
                                                         const ShadowSettings& settings);

struct ZenithSettings {
  int side_px = 1024;
  double texel_m = 0.25;  ///< so that it serves up to 107 m from the eye
  double step_m = 16;     ///< in which the map follows the eye
  double probe_m = 13;    ///< way from a point to where light.glsl asks what hides the sky
  double search_m = 20;   ///< way from a point within which things may hide sky from it
};
/// The map of what covers the ground, as light from the zenith would see it.
[[nodiscard]] ShadowCascade zenith_map(const ViewCamera& camera, const Eigen::AlignedBox3d& content,
                                       const ZenithSettings& settings);

}  // namespace rigor::render
