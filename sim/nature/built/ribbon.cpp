#include "sim/nature/built/ribbon.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numbers>

namespace rigor::nature::built {
namespace {
using Eigen::Vector2d;
constexpr double kSame_m = 0.01, kFarthest_m = 1e8;
constexpr std::size_t kMostPoints = 200'000;
constexpr double kSharp_rad = 0.7;  // outside of sharper bends is round
constexpr double kFanStep_rad = 0.2;
Vector2d left_of(const Vector2d& d) { return {-d.y(), d.x()}; }
}  // namespace

Result<Line> line_from(std::span<const double> xy, const Vector2d& origin) {
  constexpr const char* kWhere = "sim/nature/built";
  if (xy.size() % 2 != 0)
    return fail(ErrorCode::bad_input, kWhere,
                fmt::format("line: expected pairs x y, got {} numbers", xy.size()));
  if (xy.size() > 2 * kMostPoints)
    return fail(ErrorCode::bad_input, kWhere,
                fmt::format("line: {} points, expected at most {}", xy.size() / 2, kMostPoints));
  Line line;
  for (std::size_t i = 0; i + 1 < xy.size(); i += 2) {
    if (!(std::abs(xy[i]) < kFarthest_m) || !(std::abs(xy[i + 1]) < kFarthest_m))
      return fail(ErrorCode::bad_input, kWhere,
                  fmt::format("line: point {} is ({}, {}), expected metres of at most {:g}", i / 2, xy[i],
                              xy[i + 1], kFarthest_m));
    const Vector2d p(xy[i] - origin.x(), xy[i + 1] - origin.y());
    if (line.empty() || (p - line.back()).norm() >= kSame_m) line.push_back(p);
  }
  if (line.size() < 2)
    return fail(ErrorCode::bad_input, kWhere,
                fmt::format("line: {} different point(s), expected 2 or more", line.size()));
  return line;
}

std::vector<CrossSection> ribbon(const Line& line, double half_width_m) {
  const double w = half_width_m;
  std::vector<CrossSection> out;
  double along = 0;
  for (std::size_t i = 0; i < line.size(); ++i) {
    const Vector2d& p = line[i];
    if (i > 0) along += (p - line[i - 1]).norm();
    if (i == 0 || i + 1 == line.size()) {
      const Vector2d d = (i == 0 ? line[1] - p : p - line[i - 1]).normalized();
      out.push_back({p, w * left_of(d), -w * left_of(d), along});
      continue;
    }
    const Vector2d in = p - line[i - 1], go = line[i + 1] - p;
    const Vector2d d_in = in.normalized(), d_go = go.normalized();
    const double turn = std::atan2(d_in.x() * d_go.y() - d_in.y() * d_go.x(), d_in.dot(d_go));
    const double half = std::abs(turn) / 2;
    if (half < 1e-6) {
      out.push_back({p, w * left_of(d_in), -w * left_of(d_in), along});
      continue;
    }
    // Inside, no segment gives more than half of itself to a corner: so its two ends never cross, and tight
    // bends close upon their centre.
    const double reach = 0.49 * std::min(in.norm(), go.norm());
    const double inside = half < 1.57 ? std::min(w, reach / std::tan(half)) : 0.0;
    const bool to_left = turn > 0;
    const Vector2d n_in = left_of(d_in), n_go = left_of(d_go);
    const Vector2d sum = n_in + n_go;
    const Vector2d inner = inside > 0
                               ? Vector2d((to_left ? 1.0 : -1.0) * inside / std::cos(half) * sum.normalized())
                               : Vector2d(Vector2d::Zero());
    const double side = to_left ? -1.0 : 1.0;  // of the outside, along the left normal
    const auto put = [&](const Vector2d& outer) {
      out.push_back(to_left ? CrossSection{p, inner, outer, along} : CrossSection{p, outer, inner, along});
    };
    if (std::abs(turn) < kSharp_rad) {
      put(side * w / std::cos(half) * sum.normalized());
      continue;
    }
    const int steps = static_cast<int>(std::ceil(std::abs(turn) / kFanStep_rad));
    for (int k = 0; k <= steps; ++k) {
      const Eigen::Rotation2Dd r(turn * k / steps);
      put(side * w * (r * n_in));
    }
  }
  return out;
}

CrossSection between(const CrossSection& a, const CrossSection& b, double f) {
  if (f <= 0) return a;
  if (f >= 1) return b;
  return {a.middle + f * (b.middle - a.middle), a.left + f * (b.left - a.left),
          a.right + f * (b.right - a.right), a.along_m + f * (b.along_m - a.along_m)};
}

}  // namespace rigor::nature::built
