#include "sim/nature/terrain/raster.h"

#include <cstring>
#include <limits>

namespace rigor::nature {
namespace {

using world::Attribute;
using world::Blob;
using world::Snapshot;

constexpr std::int64_t kMostCells = 1LL << 34;

template <class Type>
std::optional<GridFrame> read_frame(const Snapshot& world, const Type& type, NodeId node,
                                    std::string_view kind, std::size_t cell_bytes, const Blob& blob,
                                    std::vector<std::string>* warnings) {
  const auto tell = [&](const std::string& what) -> std::optional<GridFrame> {
    if (warnings) {
      warnings->push_back(std::string(kind) + " " + std::to_string(node.value) + ": " + what +
                          "; this grid is not shown");
    }
    return std::nullopt;
  };
  const auto columns = world.get_or_default(node, type.columns), rows = world.get_or_default(node, type.rows);
  GridFrame f;
  f.x_m = world.get_or_default(node, type.x_m);
  f.y_m = world.get_or_default(node, type.y_m);
  f.spacing_m = world.get_or_default(node, type.spacing_m);
  if (columns == 0 && rows == 0 && blob.size() == 0)
    return tell("expected columns, rows and cells, got none");
  if (columns < 1 || rows < 1 || columns > (1 << 28) || rows > (1 << 28) || columns * rows > kMostCells) {
    return tell("expected at least one column and row, got " + std::to_string(columns) + " x " +
                std::to_string(rows));
  }
  if (!std::isfinite(f.x_m) || !std::isfinite(f.y_m) || !std::isfinite(f.spacing_m) || f.spacing_m <= 0) {
    return tell("expected a finite place and a spacing above 0");
  }
  f.columns = static_cast<int>(columns);
  f.rows = static_cast<int>(rows);
  const std::size_t expected = f.cell_count() * cell_bytes;
  if (blob.size() != expected) {
    return tell("expected " + std::to_string(expected) + " bytes for " + std::to_string(columns) + " x " +
                std::to_string(rows) + " cells, got " + std::to_string(blob.size()));
  }
  return f;
}

template <class GridType>
void sort_finest_first(std::vector<GridType>& grids) {
  std::sort(grids.begin(), grids.end(), [](const GridType& a, const GridType& b) {
    return a.frame.spacing_m != b.frame.spacing_m ? a.frame.spacing_m < b.frame.spacing_m : a.node < b.node;
  });
}

template <class GridType, class T, class Type>
std::vector<GridType> read_grids(const Snapshot& world, const Type& type, Attribute<Blob> cells,
                                 std::string_view kind, std::vector<std::string>& warnings) {
  std::vector<GridType> grids;
  auto nodes = world.nodes(type.type);
  std::sort(nodes.begin(), nodes.end());
  for (const NodeId node : nodes) {
    const Blob& blob = world.get_or_default(node, cells);
    if (auto frame = read_frame(world, type, node, kind, sizeof(T), blob, &warnings)) {
      GridType g;
      g.node = node;
      g.frame = *frame;
      g.blob = blob;
      g.values = g.blob.template as<T>();
      grids.push_back(std::move(g));
    }
  }
  sort_finest_first(grids);
  return grids;
}

/// Blocks of 32 x 32 cells that differ, as rectangles of cell centres.
void differing_blocks(const GridFrame& frame, std::size_t cell_bytes, std::span<const std::byte> a,
                      std::span<const std::byte> b, std::vector<Rect>& out) {
  constexpr int kBlock = 32;
  for (int r0 = 0; r0 < frame.rows; r0 += kBlock) {
    const int r1 = std::min(r0 + kBlock, frame.rows);
    for (int c0 = 0; c0 < frame.columns; c0 += kBlock) {
      const int c1 = std::min(c0 + kBlock, frame.columns);
      Rect rect;
      for (int r = r0; r < r1; ++r) {
        const std::size_t row = static_cast<std::size_t>(r) * frame.columns;
        const std::size_t from = (row + c0) * cell_bytes, bytes = (c1 - c0) * cell_bytes;
        if (std::memcmp(a.data() + from, b.data() + from, bytes) == 0) continue;
        for (int c = c0; c < c1; ++c) {
          const std::size_t at = (row + c) * cell_bytes;
          if (std::memcmp(a.data() + at, b.data() + at, cell_bytes) != 0) rect.add(frame.x(c), frame.y(r));
        }
      }
      if (!rect.empty()) out.push_back(rect);
    }
  }
}

template <class Type>
void grid_change(const world::ChangeSet& set, const world::Change& change, const Type& type,
                 Attribute<Blob> cells, std::size_t cell_bytes, std::vector<Rect>& rects,
                 std::vector<NodeId>* reshaped) {
  const auto frame_in = [&](const Snapshot& world) -> std::optional<GridFrame> {
    if (!world.contains(change.node)) return std::nullopt;
    return read_frame(world, type, change.node, "", cell_bytes, world.get_or_default(change.node, cells),
                      nullptr);
  };
  const auto before = frame_in(set.before), after = frame_in(set.after);
  const bool cells_only = before && after && *before == *after && change.kind == world::ChangeKind::changed &&
                          change.attribute == cells.id;
  if (cells_only) {
    const Blob &a = set.before.get_or_default(change.node, cells),
               &b = set.after.get_or_default(change.node, cells);
    if (a.identity() != b.identity()) differing_blocks(*before, cell_bytes, a.span(), b.span(), rects);
    return;
  }
  if (before) rects.push_back(before->cells());
  if (after) rects.push_back(after->cells());
  if (reshaped) reshaped->push_back(change.node);
}

}  // namespace

std::uint8_t cover_index(std::string_view word) {
  for (std::size_t i = 0; i < std::size(world::types::kCoverWords); ++i) {
    if (world::types::kCoverWords[i] == word) return static_cast<std::uint8_t>(i);
  }
  return kNoCover;
}

std::vector<HeightGrid> read_terrain(const Snapshot& world, std::vector<std::string>& warnings) {
  if (!world.schema().find_type("Terrain")) return {};
  const world::types::Terrain type(world.schema());
  auto grids = read_grids<HeightGrid, float>(world, type, type.heights_m, "Terrain", warnings);
  for (const auto& g : grids) {
    if (g.frame.columns < 2 || g.frame.rows < 2) {
      warnings.push_back("Terrain " + std::to_string(g.node.value) +
                         ": expected at least 2 x 2 heights, got " + std::to_string(g.frame.columns) + " x " +
                         std::to_string(g.frame.rows) + "; this grid has no area and is not shown");
    }
  }
  std::erase_if(grids, [](const HeightGrid& g) { return g.frame.columns < 2 || g.frame.rows < 2; });
  return grids;
}

std::vector<CoverGrid> read_land_cover(const Snapshot& world, std::vector<std::string>& warnings) {
  if (!world.schema().find_type("LandCover")) return {};
  const world::types::LandCover type(world.schema());
  auto grids = read_grids<CoverGrid, std::uint8_t>(world, type, type.cells, "LandCover", warnings);
  for (auto& g : grids) {
    g.word.fill(kNoCover);
    const std::string& classes = world.get_or_default(g.node, type.classes);
    std::size_t from = 0;
    for (std::size_t k = 0; from < classes.size() && k < 255; ++k) {
      const std::size_t to = std::min(classes.find(' ', from), classes.size());
      const std::string word = classes.substr(from, to - from);
      g.word[k] = cover_index(word);
      if (g.word[k] == kNoCover) {
        warnings.push_back("LandCover " + std::to_string(g.node.value) + ": classes: '" + word +
                           "' is no cover word; its cells count as unknown");
      }
      from = to + 1;
    }
  }
  return grids;
}

std::vector<PictureGrid> read_imagery(const Snapshot& world, std::vector<std::string>& warnings) {
  if (!world.schema().find_type("Imagery")) return {};
  const world::types::Imagery type(world.schema());
  return read_grids<PictureGrid, Rgb8>(world, type, type.rgb, "Imagery", warnings);
}

Rect bounds_of(std::span<const double> xy) {
  Rect r;
  for (std::size_t i = 0; i + 1 < xy.size(); i += 2) {
    if (std::isfinite(xy[i]) && std::isfinite(xy[i + 1])) r.add(xy[i], xy[i + 1]);
  }
  return r;
}

bool inside_outline(std::span<const double> xy, double x, double y) {
  bool inside = false;
  const std::size_t n = xy.size() / 2;
  for (std::size_t i = 0, j = n - 1; i < n; j = i++) {
    const double xi = xy[2 * i], yi = xy[2 * i + 1], xj = xy[2 * j], yj = xy[2 * j + 1];
    if ((yi > y) != (yj > y) && x < (xj - xi) * (y - yi) / (yj - yi) + xi) inside = !inside;
  }
  return inside;
}

GroundChanges ground_changes(const world::ChangeSet& set) {
  GroundChanges out;
  const auto& schema = set.after.schema();
  if (!schema.find_type("Terrain")) return out;
  const world::types::Terrain terrain(schema);
  const world::types::LandCover cover(schema);
  const world::types::Imagery imagery(schema);
  const world::types::Water water(schema);
  const world::types::Road road(schema);
  const auto plants = schema.require_type("GroundVegetation");
  const auto line_rects = [&](NodeId node, world::Attribute<world::Numbers> line, double margin,
                              std::vector<Rect>& rects) {
    for (const Snapshot* s : {&set.before, &set.after}) {
      if (const auto* xy = s->get(node, line)) {
        const Rect r = bounds_of(xy->span());
        if (!r.empty()) rects.push_back(r.grown(margin));
      }
    }
  };
  for (const auto& change : set.changes) {
    if (schema.is_a(change.type, terrain.type)) {
      out.terrain = true;
      grid_change(set, change, terrain, terrain.heights_m, sizeof(float), out.terrain_rects,
                  &out.reshaped_terrain);
    } else if (schema.is_a(change.type, cover.type)) {
      out.land_cover = true;
      grid_change(set, change, cover, cover.cells, 1, out.land_cover_rects, nullptr);
    } else if (schema.is_a(change.type, imagery.type)) {
      out.imagery = true;
      grid_change(set, change, imagery, imagery.rgb, sizeof(Rgb8), out.imagery_rects, nullptr);
    } else if (schema.is_a(change.type, water.type)) {
      out.water = true;
      line_rects(change.node, water.outline, 0, out.water_rects);
    } else if (schema.is_a(change.type, road.type)) {
      out.roads = true;
      double margin = 0;
      for (const Snapshot* s : {&set.before, &set.after}) {
        if (const double* w = s->get(change.node, road.width_m)) margin = std::max(margin, *w);
      }
      line_rects(change.node, road.line, margin, out.road_rects);
    } else if (schema.is_a(change.type, plants)) {
      out.plants = true;
    }
  }
  return out;
}

}  // namespace rigor::nature
