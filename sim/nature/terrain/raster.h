// The grids of a world (Terrain, LandCover, Imagery) as they lie in their blobs, checked once, and what of
// the ground a transaction has touched, as rectangles.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "sim/world/graph/changes.h"
#include "sim/world/graph/snapshot.h"
#include "sim/world/semantic_types.h"

namespace rigor::nature {

using world::NodeId;

/// World x and y, metres. Empty by default.
struct Rect {
  double x0 = 0, y0 = 0, x1 = -1, y1 = -1;
  [[nodiscard]] bool empty() const { return !(x0 <= x1 && y0 <= y1); }
  [[nodiscard]] bool overlaps(const Rect& o) const {
    return !empty() && !o.empty() && x0 <= o.x1 && o.x0 <= x1 && y0 <= o.y1 && o.y0 <= y1;
  }
  [[nodiscard]] bool contains(const Rect& o) const {
    return x0 <= o.x0 && o.x1 <= x1 && y0 <= o.y0 && o.y1 <= y1;
  }
  [[nodiscard]] bool contains(double x, double y) const { return x0 <= x && x <= x1 && y0 <= y && y <= y1; }
  [[nodiscard]] Rect grown(double by) const { return {x0 - by, y0 - by, x1 + by, y1 + by}; }
  void add(double x, double y) {
    if (empty()) {
      *this = {x, y, x, y};
    } else {
      *this = {std::min(x0, x), std::min(y0, y), std::max(x1, x), std::max(y1, y)};
    }
  }
};

/// Where the cells of a grid lie: cell (c, r) has its centre at (x_m + c·spacing, y_m − r·spacing).
struct GridFrame {
  int columns = 0, rows = 0;
  double x_m = 0, y_m = 0, spacing_m = 1;
  bool operator==(const GridFrame&) const = default;
  /// In cells: the centre of cell (c, r) is at u = c, v = r.
  [[nodiscard]] double u(double x) const { return (x - x_m) / spacing_m; }
  [[nodiscard]] double v(double y) const { return (y_m - y) / spacing_m; }
  [[nodiscard]] double x(double u) const { return x_m + u * spacing_m; }
  [[nodiscard]] double y(double v) const { return y_m - v * spacing_m; }
  /// From the first to the last centre; without area where there is one row or column.
  [[nodiscard]] Rect centres() const { return {x_m, y(rows - 1), x(columns - 1), y_m}; }
  /// With the whole of the outer cells.
  [[nodiscard]] Rect cells() const { return centres().grown(spacing_m / 2); }
  [[nodiscard]] std::size_t cell_count() const { return static_cast<std::size_t>(columns) * rows; }
};

/// A grid and its values, which live as long as the blob that it holds.
template <class T>
struct Grid {
  NodeId node;
  GridFrame frame;
  world::Blob blob;
  std::span<const T> values;
  [[nodiscard]] const T& at(int column, int row) const {
    return values[static_cast<std::size_t>(row) * frame.columns + column];
  }
};

struct Rgb8 {
  std::uint8_t r, g, b;
};
/// Land cover as words of kCoverWords; `word` turns a cell's value into an index, kNoCover where unknown.
inline constexpr std::uint8_t kNoCover = 255;
struct CoverGrid : Grid<std::uint8_t> {
  std::array<std::uint8_t, 256> word{};
  [[nodiscard]] std::uint8_t cover(int column, int row) const { return word[at(column, row)]; }
};
using HeightGrid = Grid<float>;
using PictureGrid = Grid<Rgb8>;

[[nodiscard]] std::uint8_t cover_index(std::string_view word);

/// All grids of the world, finest first, then by node id. What cannot be used is left out and told of.
[[nodiscard]] std::vector<HeightGrid> read_terrain(const world::Snapshot& world,
                                                   std::vector<std::string>& warnings);
[[nodiscard]] std::vector<CoverGrid> read_land_cover(const world::Snapshot& world,
                                                     std::vector<std::string>& warnings);
[[nodiscard]] std::vector<PictureGrid> read_imagery(const world::Snapshot& world,
                                                    std::vector<std::string>& warnings);

/// What a transaction changed of the ground, where. A grid that was made, removed or moved: its whole extent,
/// old and new. One whose blob alone changed: blocks of 32 x 32 cells in which cells differ.
struct GroundChanges {
  bool terrain = false, land_cover = false, imagery = false, water = false, roads = false, plants = false;
  std::vector<Rect> terrain_rects, land_cover_rects, imagery_rects, water_rects, road_rects;
  std::vector<NodeId> reshaped_terrain;  ///< made, removed, or another frame: no block of it can be kept
  [[nodiscard]] bool any() const { return terrain || land_cover || imagery || water || roads || plants; }
};
[[nodiscard]] GroundChanges ground_changes(const world::ChangeSet& changes);

/// Bounds of an outline or line x0 y0 x1 y1 …
[[nodiscard]] Rect bounds_of(std::span<const double> xy);
/// Even-odd rule.
[[nodiscard]] bool inside_outline(std::span<const double> xy, double x, double y);

}  // namespace rigor::nature
