#include "sim/render/view/shadow_cascades.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <numbers>

namespace rigor::render {
namespace {

/// How far a square may lie off its slice, as a share of the slice's radius.
constexpr double kRoom = 0.25;
/// Of a shadow map, about what is seen: filters look at neighbours.
constexpr int kMargin_texels = 2;
/// Steps in which maps of depth begin and end, along their axis in the world.
constexpr double kDepthStep_m = 64;

double stepped(double v, double step) { return std::round(v / step) * step; }

/// Outward edges of the convex outline of points, each pushed out by a margin.
std::vector<Eigen::Vector3d> outline_of(std::vector<Eigen::Vector2d> points, double margin_m) {
  std::sort(points.begin(), points.end(), [](const Eigen::Vector2d& a, const Eigen::Vector2d& b) {
    return a.x() != b.x() ? a.x() < b.x() : a.y() < b.y();
  });
  std::vector<Eigen::Vector2d> hull;
  const auto add = [&](const Eigen::Vector2d& p, std::size_t keep) {
    while (hull.size() >= keep + 2) {
      const Eigen::Vector2d a = hull.back() - hull[hull.size() - 2], b = p - hull.back();
      if (a.x() * b.y() - a.y() * b.x() > 0) break;
      hull.pop_back();
    }
    hull.push_back(p);
  };
  for (const auto& p : points) add(p, 0);
  const std::size_t lower = hull.size() - 1;
  for (auto p = points.rbegin() + 1; p != points.rend(); ++p) add(*p, lower);
  std::vector<Eigen::Vector3d> out;
  for (std::size_t i = 0; i + 1 < hull.size(); ++i) {
    const Eigen::Vector2d e = hull[i + 1] - hull[i];
    if (!(e.norm() > 1e-9)) continue;
    const Eigen::Vector2d n = Eigen::Vector2d(e.y(), -e.x()).normalized();
    out.emplace_back(n.x(), n.y(), n.dot(hull[i]) + margin_m);
  }
  return out;
}

/// Corners of the view between two depths, relative to the eye.
std::array<Eigen::Vector3d, 8> corners_of(const ViewCamera& camera, double from, double to) {
  const auto edges = camera.edges();
  std::array<Eigen::Vector3d, 8> out;
  std::size_t i = 0;
  for (const double d : {from, to})
    for (const double u : {edges[0], edges[1]})
      for (const double v : {edges[2], edges[3]})
        out[i++] = d * (camera.forward + u * camera.right + v * camera.down);
  return out;
}
/// As above, in a cascade's plane.
std::vector<Eigen::Vector2d> corners_of(const ViewCamera& camera, double from, double to,
                                        const ShadowCascade& c) {
  std::vector<Eigen::Vector2d> out;
  for (const Eigen::Vector3d& corner : corners_of(camera, from, to)) {
    const Eigen::Vector3d p = camera.eye - c.centre + corner;
    out.emplace_back(p.dot(c.x), p.dot(c.y));
  }
  return out;
}

}  // namespace

bool ShadowCascade::reaches(const Eigen::Vector3d& p_world, double radius_m) const {
  const Eigen::Vector3d d = p_world - centre;
  const double reach = half_side_m + radius_m;
  return std::abs(d.dot(x)) <= reach && std::abs(d.dot(y)) <= reach && d.dot(z) - radius_m <= receivers_far_m;
}

bool ShadowCascade::may_shade(const Eigen::Vector3d& p_world, double radius_m) const {
  if (!reaches(p_world, radius_m)) return false;
  const Eigen::Vector3d d = p_world - centre;
  const Eigen::Vector2d at(d.dot(x), d.dot(y));
  return std::all_of(outline.begin(), outline.end(), [&](const Eigen::Vector3d& e) {
    return e.x() * at.x() + e.y() * at.y() <= e.z() + radius_m;
  });
}

view_gpu::CascadeData ShadowCascade::data(int side_px, const Eigen::Vector3d& eye_world) const {
  const double per_m = 1.0 / texel_m, depth = far_m - near_m;
  const Eigen::Vector3d from_eye = centre - eye_world;
  view_gpu::CascadeData c;
  c.row_x = view_gpu::xyz(x * per_m, 0.5 * side_px - x.dot(from_eye) * per_m);
  c.row_y = view_gpu::xyz(y * per_m, 0.5 * side_px - y.dot(from_eye) * per_m);
  c.row_z = view_gpu::xyz(z / depth, (-near_m - z.dot(from_eye)) / depth);
  c.range = {static_cast<float>(view_depth_m), static_cast<float>(texel_m), static_cast<float>(side_px),
             static_cast<float>(depth)};
  return c;
}

int shadow_side_px(const Pinhole& pinhole, std::uint32_t limit_px) {
  const auto wanted =
      static_cast<std::uint32_t>(std::max({pinhole.width_px, pinhole.height_px, 170}) * 3 / 2);
  // A power of two, and as much more as squares are larger than what they are for.
  const auto side = static_cast<std::uint32_t>((1 + kRoom) * std::bit_ceil(wanted));
  return static_cast<int>(std::min({side, 4096U, limit_px}));
}

std::vector<ShadowCascade> shadow_cascades(const ViewCamera& camera, const Eigen::Vector3d& to_sun,
                                           const Eigen::AlignedBox3d& content,
                                           const ShadowSettings& settings) {
  std::vector<ShadowCascade> all;
  if (content.isEmpty()) return all;
  const auto edges = camera.edges();
  // Depths along the view that hold anything.
  double nearest = 1e300, farthest = 0;
  for (int i = 0; i < 8; ++i) {
    const double d = content.corner(static_cast<Eigen::AlignedBox3d::CornerType>(i)).dot(camera.forward);
    nearest = std::min(nearest, d);
    farthest = std::max(farthest, d);
  }
  // In few steps: slices that follow the content would change the squares with each step of the eye.
  const auto quarter_octave = [](double v, auto round) { return std::exp2(0.25 * round(4 * std::log2(v))); };
  const double begin =
      nearest > camera.pinhole.near_m
          ? std::max(camera.pinhole.near_m, quarter_octave(nearest, [](double v) { return std::floor(v); }))
          : camera.pinhole.near_m;
  const double end =
      std::min(quarter_octave(farthest, [](double v) { return std::ceil(v); }), settings.reach_m);
  if (!(end > begin)) return all;
  Eigen::Vector3d z = -to_sun, x = z.unitOrthogonal();
  // Axes that do not turn with the eye; with the sun high up, from north.
  x = (std::abs(z.z()) > 0.99 ? Eigen::Vector3d::UnitX() : Eigen::Vector3d::UnitZ()).cross(z).normalized();
  const Eigen::Vector3d y = z.cross(x);
  // Slices grow by a constant factor, from where a slice is about as wide as it is deep.
  const double first = std::max(begin, std::min(end, std::max(2.0 * begin, end / 64)));
  const double growth = std::pow(end / first, 1.0 / (view_gpu::kSunCascades - 1));
  double from = begin;
  for (std::size_t i = 0; i < view_gpu::kSunCascades && from < end * 0.9999; ++i) {
    const double to = i + 1 == view_gpu::kSunCascades
                          ? end
                          : std::min(end, first * std::pow(growth, static_cast<double>(i)));
    if (!(to > from)) continue;
    // The smallest sphere about the slice: its centre on the slice's middle line.
    const double mx = 0.5 * (edges[0] + edges[1]), my = 0.5 * (edges[2] + edges[3]);
    const Eigen::Vector3d line = camera.forward + mx * camera.right + my * camera.down;
    const double wide2 = std::pow(0.5 * (edges[1] - edges[0]), 2) + std::pow(0.5 * (edges[3] - edges[2]), 2);
    Eigen::Vector3d centre =
        line * std::clamp(0.5 * (from + to) * (1 + wide2 / line.squaredNorm()), from, to);
    double radius = 0;
    for (const Eigen::Vector3d& corner : corners_of(camera, from, to))
      radius = std::max(radius, 1.01 * (corner - centre).norm());
    // What can be seen lies in the content too: a small scene deserves a small square.
    const double content_radius = 0.5 * content.diagonal().norm();
    if (content_radius < radius) {
      radius = content_radius;
      centre = content.center();
    }
    ShadowCascade c;
    c.x = x;
    c.y = y;
    c.z = z;
    c.view_depth_m = to;
    // Few different radii, so that squares of the same size follow each other.
    radius = std::exp2(std::ceil(std::log2(radius) * 8) / 8);
    const int inner_texels = settings.side_px - 2 * kMargin_texels;
    c.texel_m = 2 * radius * (1 + kRoom) / inner_texels;
    c.half_side_m = 0.5 * c.texel_m * settings.side_px;
    const double step_m = std::floor(kRoom / (1 + kRoom) * inner_texels) * c.texel_m;
    const Eigen::Vector3d place = camera.eye + centre;
    c.centre = x * stepped(x.dot(place), step_m) + y * stepped(y.dot(place), step_m) +
               z * stepped(z.dot(place), step_m);
    // What is lit lies within the sphere, a few texels off its surface.
    c.receivers_far_m = radius + 0.5 * step_m + 4 * c.texel_m;
    c.far_m = c.receivers_far_m + 1.0;
    double highest_m = 1e300;
    for (int k = 0; k < 8; ++k)
      highest_m = std::min(
          highest_m, z.dot(camera.eye + content.corner(static_cast<Eigen::AlignedBox3d::CornerType>(k))));
    c.near_m = std::floor((highest_m - 1) / kDepthStep_m) * kDepthStep_m - z.dot(c.centre);
    c.outline = outline_of(corners_of(camera, from, to, c), 4 * c.texel_m);
    if (c.far_m > c.near_m) all.push_back(c);
    from = to;
  }
  return all;
}

ShadowCascade zenith_map(const ViewCamera& camera, const Eigen::AlignedBox3d& content,
                         const ZenithSettings& settings) {
  ShadowCascade c;
  c.x = Eigen::Vector3d::UnitX();
  c.y = -Eigen::Vector3d::UnitY();
  c.z = -Eigen::Vector3d::UnitZ();
  c.texel_m = settings.texel_m;
  c.half_side_m = 0.5 * settings.texel_m * settings.side_px;
  for (int k = 0; k < 3; ++k) c.centre[k] = stepped(camera.eye[k], settings.step_m);
  const auto whole = [&](double v) { return std::ceil(v / settings.step_m) * settings.step_m; };
  c.near_m = c.centre.z() - whole(camera.eye.z() + content.max().z() + 1.0);
  c.far_m = c.receivers_far_m = c.centre.z() + whole(1.0 - camera.eye.z() - content.min().z());
  c.view_depth_m = c.half_side_m - 0.5 * settings.step_m - settings.probe_m;
  // No part of the content that the square has is farther from the eye.
  const double deepest_m = std::numbers::sqrt2 * (c.half_side_m + settings.step_m) +
                           std::max(std::abs(content.min().z()), std::abs(content.max().z()));
  c.outline = outline_of(corners_of(camera, 0.0, deepest_m, c), settings.search_m);
  return c;
}

}  // namespace rigor::render
