// A line as a band of cross-sections: corners mitred, sharp ones rounded outside, and never folded over
// inside.
#pragma once

#include <Eigen/Geometry>
#include <span>
#include <string>
#include <vector>

#include "rt-core/result.h"

namespace rigor::nature::built {

/// At s between −1 (right edge) and 1 (left edge) the section is at middle + s·left for s ≥ 0, middle −
/// s·right else. Sections at a corner may turn about their middle.
struct CrossSection {
  Eigen::Vector2d middle, left, right;
  double along_m = 0;  ///< way along the middle from the start
  [[nodiscard]] Eigen::Vector2d at(double s) const { return middle + (s >= 0 ? s * left : -s * right); }
};

using Line = std::vector<Eigen::Vector2d>;

/// A line from numbers x0 y0 x1 y1 … relative to `origin`, points on each other once. bad_input: fewer than 2
/// different points, not finite.
[[nodiscard]] Result<Line> line_from(std::span<const double> xy, const Eigen::Vector2d& origin);

/// Sections at the ends and corners alone: what lies between is straight.
[[nodiscard]] std::vector<CrossSection> ribbon(const Line& line, double half_width_m);

/// The section a share `f` of the way from a to b.
[[nodiscard]] CrossSection between(const CrossSection& a, const CrossSection& b, double f);

}  // namespace rigor::nature::built
