#include "sim/nature/built/terrain_change.h"

#include <algorithm>
#include <cstring>

#include "sim/world/semantic_types.h"

namespace rigor::nature::built {
namespace {
using Eigen::AlignedBox2d;
using Eigen::Vector2d;

struct Grid {
  std::int64_t columns = 0, rows = 0;
  double x_m = 0, y_m = 0, spacing_m = 1;
  std::span<const float> heights;
  [[nodiscard]] bool whole() const {
    return columns > 0 && rows > 0 && heights.size() == static_cast<std::size_t>(columns * rows);
  }
  [[nodiscard]] bool lies_as(const Grid& o) const {
    return columns == o.columns && rows == o.rows && x_m == o.x_m && y_m == o.y_m && spacing_m == o.spacing_m;
  }
  // Cells reach one spacing around their centre, as far as interpolation between centres does.
  [[nodiscard]] AlignedBox2d box(std::int64_t c0, std::int64_t r0, std::int64_t c1, std::int64_t r1) const {
    const double s = spacing_m;
    return {Vector2d(x_m + (static_cast<double>(c0) - 1) * s, y_m - (static_cast<double>(r1) + 1) * s),
            Vector2d(x_m + (static_cast<double>(c1) + 1) * s, y_m - (static_cast<double>(r0) - 1) * s)};
  }
  [[nodiscard]] AlignedBox2d all() const {
    return whole() ? box(0, 0, columns - 1, rows - 1) : AlignedBox2d();
  }
};

Grid grid_of(const world::Snapshot& s, world::NodeId node) {
  if (!s.contains(node)) return {};
  const world::types::Terrain t(s.schema());
  return {s.get_or_default(node, t.columns),   s.get_or_default(node, t.rows),
          s.get_or_default(node, t.x_m),       s.get_or_default(node, t.y_m),
          s.get_or_default(node, t.spacing_m), s.get_or_default(node, t.heights_m).as<float>()};
}
}  // namespace

AlignedBox2d changed_ground(const world::Snapshot& before, const world::Snapshot& after,
                            world::NodeId terrain) {
  const Grid a = grid_of(before, terrain), b = grid_of(after, terrain);
  AlignedBox2d out;
  if (!a.whole() || !b.whole() || !a.lies_as(b)) {
    out.extend(a.all());
    out.extend(b.all());
    return out;
  }
  const auto columns = static_cast<std::size_t>(a.columns);
  for (std::size_t r = 0; r < static_cast<std::size_t>(a.rows); ++r) {
    const float *p = a.heights.data() + r * columns, *q = b.heights.data() + r * columns;
    if (p == q || std::memcmp(p, q, columns * sizeof(float)) == 0) continue;
    const auto differs = [&](std::size_t c) { return std::memcmp(p + c, q + c, sizeof(float)) != 0; };
    std::size_t first = 0, last = columns - 1;
    while (!differs(first)) ++first;
    while (!differs(last)) --last;
    const auto row = static_cast<std::int64_t>(r);
    out.extend(a.box(static_cast<std::int64_t>(first), row, static_cast<std::int64_t>(last), row));
  }
  return out;
}

}  // namespace rigor::nature::built
