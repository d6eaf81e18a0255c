// Plane polygons with holes: what maps give is cleaned here once, so that everything after it may rely on
// simple rings. Metres, double; buildings work relative to an origin of their own near the footprint.
#pragma once

#include <Eigen/Geometry>
#include <array>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "rt-core/result.h"

namespace rigor::nature::built {

using Ring = std::vector<Eigen::Vector2d>;

/// Simple rings that do not touch: the outer anticlockwise, holes clockwise, neither closed by a repeated
/// point. Inside is on the left of every edge. Edges are numbered ring by ring, the outer first.
struct Polygon {
  Ring outer;
  std::vector<Ring> holes;
  [[nodiscard]] std::size_t edge_count() const;
  /// Outer ring first.
  [[nodiscard]] std::vector<std::span<const Eigen::Vector2d>> rings() const;
};

[[nodiscard]] double signed_area(std::span<const Eigen::Vector2d> ring);  ///< anticlockwise: above 0
[[nodiscard]] double area(const Polygon& polygon);
[[nodiscard]] bool contains(std::span<const Eigen::Vector2d> ring, const Eigen::Vector2d& p);
[[nodiscard]] bool contains(const Polygon& polygon, const Eigen::Vector2d& p);
/// No two edges that are not neighbours come nearer to each other than `gap_m`.
[[nodiscard]] bool is_simple(const Polygon& polygon, double gap_m);

/// A polygon from numbers x0 y0 x1 y1 …; `holes`: count of numbers, ring, count, ring …; all relative to
/// `origin`. Points that lie on each other or on a line, spikes, the wrong sense of rotation and small loops
/// are mended; what was mended at a loss is told in `mended`. bad_input: fewer than 3 points, no area, not
/// finite, crosses itself so that it is not clear what is meant.
[[nodiscard]] Result<Polygon> polygon_from(std::span<const double> footprint, std::span<const double> holes,
                                           const Eigen::Vector2d& origin, std::vector<std::string>& mended);
/// A point near the numbers, on whole metres; zero where none of them is finite.
[[nodiscard]] Eigen::Vector2d origin_near(std::span<const double> xy);

/// Every edge moved out (negative: in) by its own distance, corners mitred. Empty where edges would vanish or
/// cross.
[[nodiscard]] std::optional<Polygon> offset(const Polygon& polygon, std::span<const double> distance_m);
[[nodiscard]] std::optional<Polygon> offset(const Polygon& polygon, double distance_m);

/// Anticlockwise triangles that cover the polygon, corners among its own (ear clipping).
[[nodiscard]] std::vector<std::array<Eigen::Vector2d, 3>> triangulate(const Polygon& polygon);

}  // namespace rigor::nature::built
