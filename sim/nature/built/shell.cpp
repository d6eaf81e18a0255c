#include "sim/nature/built/shell.h"

#include <algorithm>
#include <cmath>
#include <map>

namespace rigor::nature::built {
namespace {

using Eigen::Vector3d;

// Points by cells of a grid as wide as `same_m`, so that only neighbours are compared.
class Points {
 public:
  explicit Points(double same_m) : same_m_(same_m) {}
  int index_of(const Vector3d& p) {
    const Cell c = cell_of(p);
    for (long dz = -1; dz <= 1; ++dz)
      for (long dy = -1; dy <= 1; ++dy)
        for (long dx = -1; dx <= 1; ++dx) {
          const auto found = cells_.find({c[0] + dx, c[1] + dy, c[2] + dz});
          if (found == cells_.end()) continue;
          for (const int i : found->second)
            if ((points[static_cast<std::size_t>(i)] - p).norm() < same_m_) return i;
        }
    points.push_back(p);
    cells_[c].push_back(static_cast<int>(points.size()) - 1);
    return static_cast<int>(points.size()) - 1;
  }
  std::vector<Vector3d> points;

 private:
  using Cell = std::array<long, 3>;
  [[nodiscard]] Cell cell_of(const Vector3d& p) const {
    return {std::lround(p.x() / same_m_), std::lround(p.y() / same_m_), std::lround(p.z() / same_m_)};
  }
  double same_m_;
  std::map<Cell, std::vector<int>> cells_;
};

bool degenerate(const std::array<int, 3>& c) { return c[0] == c[1] || c[1] == c[2] || c[2] == c[0]; }

// Splits facets at points that lie within their edges. True: something was split.
bool split_once(Shell& shell, double same_m) {
  const auto open = open_edges(shell);
  if (open.empty()) return false;
  std::vector<int> candidates;
  for (const auto& e : open) {
    candidates.push_back(e[0]);
    candidates.push_back(e[1]);
  }
  std::sort(candidates.begin(), candidates.end());
  candidates.erase(std::unique(candidates.begin(), candidates.end()), candidates.end());
  const std::vector<std::array<int, 2>> sorted = [&] {
    auto s = open;
    std::sort(s.begin(), s.end());
    return s;
  }();
  bool any = false;
  std::vector<Facet> out;
  out.reserve(shell.facets.size());
  for (const Facet& f : shell.facets) {
    bool done = false;
    for (std::size_t k = 0; k < 3 && !done; ++k) {
      const int a = f.corner[k], b = f.corner[(k + 1) % 3], c = f.corner[(k + 2) % 3];
      if (!std::binary_search(sorted.begin(), sorted.end(), std::array<int, 2>{a, b})) continue;
      const Vector3d &pa = shell.points[static_cast<std::size_t>(a)],
                     &pb = shell.points[static_cast<std::size_t>(b)];
      const Vector3d d = pb - pa;
      std::vector<std::pair<double, int>> on;
      for (const int i : candidates) {
        if (i == a || i == b || i == c) continue;
        const Vector3d q = shell.points[static_cast<std::size_t>(i)] - pa;
        const double s = q.dot(d) / d.squaredNorm();
        if (s <= 0 || s >= 1 || (q - s * d).norm() > 2 * same_m) continue;
        on.emplace_back(s, i);
      }
      if (on.empty()) continue;
      std::sort(on.begin(), on.end());
      int last = a;
      for (const auto& [s, i] : on) {
        out.push_back({{last, i, c}, f.tag});
        last = i;
      }
      out.push_back({{last, b, c}, f.tag});
      done = any = true;
    }
    if (!done) out.push_back(f);
  }
  std::erase_if(out, [](const Facet& f) { return degenerate(f.corner); });
  shell.facets = std::move(out);
  return any;
}

}  // namespace

Shell weld(const std::vector<std::array<Vector3d, 3>>& triangles, const std::vector<int>& tags,
           double same_m) {
  Points points(same_m);
  Shell shell;
  for (std::size_t t = 0; t < triangles.size(); ++t) {
    Facet f{.tag = tags[t]};
    for (std::size_t k = 0; k < 3; ++k) f.corner[k] = points.index_of(triangles[t][k]);
    if (degenerate(f.corner)) continue;
    shell.facets.push_back(f);
  }
  shell.points = std::move(points.points);
  for (int pass = 0; pass < 16 && split_once(shell, same_m); ++pass) {
  }
  return shell;
}

std::vector<std::array<int, 2>> open_edges(const Shell& shell) {
  std::map<std::array<int, 2>, int> balance;
  for (const Facet& f : shell.facets)
    for (std::size_t k = 0; k < 3; ++k) {
      const int a = f.corner[k], b = f.corner[(k + 1) % 3];
      if (a < b)
        ++balance[{a, b}];
      else
        --balance[{b, a}];
    }
  std::vector<std::array<int, 2>> open;
  for (const auto& [e, n] : balance) {
    if (n > 0) open.push_back(e);
    if (n < 0) open.push_back({e[1], e[0]});
  }
  return open;
}

double volume(const Shell& shell) {
  if (shell.points.empty()) return 0;
  const Vector3d o = shell.points.front();
  double six = 0;
  for (const Facet& f : shell.facets) {
    const auto p = [&](std::size_t k) -> Vector3d {
      return shell.points[static_cast<std::size_t>(f.corner[k])] - o;
    };
    six += p(0).dot(p(1).cross(p(2)));
  }
  return six / 6;
}

}  // namespace rigor::nature::built
