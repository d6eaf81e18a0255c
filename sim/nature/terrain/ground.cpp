#include "sim/nature/terrain/ground.h"

#include <limits>

#include "rt-core/numbers.h"

namespace rigor::nature {
namespace {

/// The ground may stand this much above a sheet of water and still count as its bed: error of
/// elevation data.
constexpr double kBedAbove_m = 0.5;
/// Where the heights of water cells differ by more than this, the water is no lake.
constexpr double kLakeRange_m = 1.5;

struct Corner {
  int c, r;
  double fu, fv;
};
/// The cell of (u, v) and the place within; false outside.
bool locate(const GridFrame& f, double u, double v, Corner& k) {
  constexpr double kSlack = 1e-9;
  if (!(u >= -kSlack && v >= -kSlack && u <= f.columns - 1 + kSlack && v <= f.rows - 1 + kSlack))
    return false;
  u = std::clamp(u, 0.0, f.columns - 1.0);
  v = std::clamp(v, 0.0, f.rows - 1.0);
  k.c = std::min(static_cast<int>(u), f.columns - 2);
  k.r = std::min(static_cast<int>(v), f.rows - 2);
  k.fu = u - k.c;
  k.fv = v - k.r;
  return true;
}

Eigen::Vector2d node_slope(const HeightGrid& g, int c, int r) {
  const double here = g.at(c, r), s = g.frame.spacing_m;
  const auto difference = [&](double low, double high) {
    if (std::isfinite(low) && std::isfinite(high)) return (high - low) / (2 * s);
    if (std::isfinite(low)) return (here - low) / s;
    if (std::isfinite(high)) return (high - here) / s;
    return 0.0;
  };
  const double west = c > 0 ? g.at(c - 1, r) : kNaN, east = c + 1 < g.frame.columns ? g.at(c + 1, r) : kNaN;
  const double south = r + 1 < g.frame.rows ? g.at(c, r + 1) : kNaN, north = r > 0 ? g.at(c, r - 1) : kNaN;
  return {difference(west, east), difference(south, north)};
}

/// Sum of corner values by bilinear weight; corners of weight 0 are not looked at.
template <class T, class Value>
T bilinear(const Corner& k, T sum, const Value& value) {
  for (int j = 0; j < 2; ++j) {
    for (int i = 0; i < 2; ++i) {
      const double w = (i ? k.fu : 1 - k.fu) * (j ? k.fv : 1 - k.fv);
      if (w > 0) sum += w * value(k.c + i, k.r + j);
    }
  }
  return sum;
}

}  // namespace

double grid_height(const HeightGrid& grid, double u, double v) {
  Corner k{};
  if (!locate(grid.frame, u, v, k)) return kNaN;
  const double h = bilinear(k, 0.0, [&](int c, int r) { return static_cast<double>(grid.at(c, r)); });
  return std::isfinite(h) ? h : kNaN;
}

Eigen::Vector2d grid_slope(const HeightGrid& grid, double u, double v) {
  Corner k{};
  if (!locate(grid.frame, u, v, k)) return {kNaN, kNaN};
  return bilinear(k, Eigen::Vector2d(0, 0), [&](int c, int r) { return node_slope(grid, c, r); });
}

bool quad_valid(const HeightGrid& grid, int c, int r) {
  return std::isfinite(grid.at(c, r)) && std::isfinite(grid.at(c + 1, r)) &&
         std::isfinite(grid.at(c, r + 1)) && std::isfinite(grid.at(c + 1, r + 1));
}

std::uint8_t CoverMix::strongest() const {
  int best = 0;
  for (int i = 1; i < count; ++i) {
    if (weight[i] > weight[best]) best = i;
  }
  return cover[best];
}

FractalNoise border_noise(std::uint8_t cover, double spacing_m) {
  const int longest = std::max(-2, static_cast<int>(std::floor(std::log2(spacing_m / 1.5))));
  return {.stream = 64U + cover, .longest = longest, .shortest = std::min(longest, -2), .gain = 0.65};
}

Ground::Ground(const world::Snapshot& world, std::vector<std::string>& warnings)
    : terrain(read_terrain(world, warnings)),
      covers(read_land_cover(world, warnings)),
      pictures(read_imagery(world, warnings)) {
  find_waters(world);
  warnings.insert(warnings.end(), water_warnings_.begin(), water_warnings_.end());
}

Ground::Ground(const world::Snapshot& world, std::vector<std::string>& warnings, const Ground& same_waters)
    : terrain(read_terrain(world, warnings)),
      covers(read_land_cover(world, warnings)),
      pictures(read_imagery(world, warnings)),
      waters(same_waters.waters),
      water_of_cell_(same_waters.water_of_cell_),
      water_warnings_(same_waters.water_warnings_),
      outlined_from_(same_waters.outlined_from_) {
  warnings.insert(warnings.end(), water_warnings_.begin(), water_warnings_.end());
}

double Ground::height_at(double x, double y, std::size_t first) const {
  for (std::size_t i = first; i < terrain.size(); ++i) {
    const auto& f = terrain[i].frame;
    const double h = grid_height(terrain[i], f.u(x), f.v(y));
    if (!std::isnan(h)) return h;
  }
  return kNaN;
}

Eigen::Vector2d Ground::slope_at(double x, double y) const {
  for (const auto& g : terrain) {
    const double u = g.frame.u(x), v = g.frame.v(y);
    if (!std::isnan(grid_height(g, u, v))) return grid_slope(g, u, v);
  }
  return {kNaN, kNaN};
}

Share Ground::covered_by_finer(std::size_t grid, const Rect& rect) const {
  bool some = false;
  for (std::size_t i = 0; i < grid; ++i) {
    const auto& f = terrain[i].frame;
    const double u0 = std::max(f.u(rect.x0), 0.0), u1 = std::min(f.u(rect.x1), f.columns - 1.0);
    const double v0 = std::max(f.v(rect.y1), 0.0), v1 = std::min(f.v(rect.y0), f.rows - 1.0);
    constexpr double kTouch = 1e-6;  // of a cell: grids that share an edge do not overlap
    if (u1 - u0 <= kTouch || v1 - v0 <= kTouch) continue;
    const bool whole = f.centres().grown(kTouch * f.spacing_m).contains(rect);
    std::size_t valid = 0, seen = 0;
    const int c1 = std::min(static_cast<int>(std::ceil(u1 - kTouch)), f.columns - 1);
    const int r1 = std::min(static_cast<int>(std::ceil(v1 - kTouch)), f.rows - 1);
    for (int r = static_cast<int>(v0 + kTouch); r < r1; ++r) {
      for (int c = static_cast<int>(u0 + kTouch); c < c1; ++c, ++seen) valid += quad_valid(terrain[i], c, r);
    }
    if (whole && seen > 0 && valid == seen) return Share::all;
    some = some || valid > 0;
  }
  return some ? Share::part : Share::none;
}

bool Ground::mix_in(const CoverGrid& g, double x, double y, CoverMix& mix) {
  const auto& f = g.frame;
  if (!f.cells().contains(x, y)) return false;
  const double u = f.u(x), v = f.v(y);
  // Of −0.5 … size: the number below.
  const auto below = [](double at) { return static_cast<int>(at + 1) - 1; };
  const int u0 = below(u), v0 = below(v);
  const int c0 = std::clamp(u0, 0, f.columns - 1), c1 = std::clamp(u0 + 1, 0, f.columns - 1);
  const int r0 = std::clamp(v0, 0, f.rows - 1), r1 = std::clamp(v0 + 1, 0, f.rows - 1);
  const std::uint8_t around[2][2] = {{g.cover(c0, r0), g.cover(c1, r0)}, {g.cover(c0, r1), g.cover(c1, r1)}};
  const double fu = u - u0, fv = v - v0;
  // A half lies nearer to the next cell.
  if (around[fv >= 0.5 ? 1 : 0][fu >= 0.5 ? 1 : 0] == kNoCover) return false;
  if (around[0][0] == around[0][1] && around[0][0] == around[1][0] && around[0][0] == around[1][1]) {
    mix = {1, {around[0][0]}, {1.0F}};
    return true;
  }
  float sum = 0;
  for (int j = 0; j < 2; ++j) {
    for (int i = 0; i < 2; ++i) {
      const auto w = static_cast<float>((i ? fu : 1 - fu) * (j ? fv : 1 - fv));
      const std::uint8_t cover = around[j][i];
      if (cover == kNoCover || w <= 0) continue;
      int k = 0;
      while (k < mix.count && mix.cover[k] != cover) ++k;
      if (k == mix.count) mix.cover[mix.count++] = cover;
      mix.weight[k] += w;
      sum += w;
    }
  }
  for (int k = 0; k < mix.count; ++k) mix.weight[k] /= sum;
  return true;
}

std::optional<std::uint8_t> Ground::one_cover(const Rect& rect) const {
  for (const auto& g : covers) {
    const auto& f = g.frame;
    const Rect cells = f.cells();
    if (!cells.overlaps(rect)) continue;
    if (!cells.contains(rect)) return std::nullopt;
    // All cells that mix_in() may look at.
    const auto cell = [](double at, int size) {
      return std::clamp(static_cast<int>(std::floor(at)), 0, size - 1);
    };
    const int c0 = cell(f.u(rect.x0), f.columns), c1 = cell(f.u(rect.x1) + 1, f.columns),
              r0 = cell(f.v(rect.y1), f.rows), r1 = cell(f.v(rect.y0) + 1, f.rows);
    const std::uint8_t first = g.cover(c0, r0);
    if (first == kNoCover) return std::nullopt;
    for (int r = r0; r <= r1; ++r)
      for (int c = c0; c <= c1; ++c)
        if (g.cover(c, r) != first) return std::nullopt;
    return first;
  }
  return kBareGround;
}

std::uint8_t Ground::cover_at(double x, double y) const {
  return cover_mix(x, y,
                   [&](std::uint8_t c, double spacing) {
                     const auto noise = border_noise(c, spacing);
                     return noise_at(noise, x, y) / noise.sigma();
                   })
      .strongest();
}

const WaterBody* Ground::body_at(double x, double y) const {
  for (std::size_t k = 0; water_of_cell_ && k < water_of_cell_->size(); ++k) {
    const auto& body_of = (*water_of_cell_)[k];
    if (body_of.empty()) continue;
    const auto& f = covers[k].frame;
    if (!f.cells().contains(x, y)) continue;
    const int c = std::clamp(static_cast<int>(std::floor(f.u(x) + 0.5)), 0, f.columns - 1);
    const int r = std::clamp(static_cast<int>(std::floor(f.v(y) + 0.5)), 0, f.rows - 1);
    const int id = body_of[static_cast<std::size_t>(r) * f.columns + c];
    if (id >= 0 && !waters[id].cells.empty()) return &waters[id];
  }
  return nullptr;
}

bool Ground::under_sheet(double x, double y, double z) const {
  const auto counts = [&](const WaterBody& b) { return !b.follows && z <= b.level_m + kBedAbove_m; };
  if (const auto* body = body_at(x, y); body && counts(*body)) return true;
  for (std::size_t i = outlined_from_; i < waters.size(); ++i) {
    const auto& body = waters[i];
    if (counts(body) && body.bounds.contains(x, y) && inside_outline(body.outline.span(), x, y)) return true;
  }
  return false;
}

bool Ground::under_water(double x, double y, double z) const {
  if (under_sheet(x, y, z)) return true;
  const auto* body = body_at(x, y);
  return body && body->follows;
}

bool Ground::is_river(double x, double y) const {
  static const std::uint8_t water = cover_index("water");
  if (cover_at(x, y) != water) return false;
  // The border wanders, so the cell of a point of the river may be one beside the river's.
  const double step = covers.empty() ? 0 : covers.front().frame.spacing_m / 2;
  for (const auto& [dx, dy] : {std::pair{0.0, 0.0}, {step, 0.0}, {-step, 0.0}, {0.0, step}, {0.0, -step}}) {
    if (const auto* body = body_at(x + dx, y + dy)) return body->follows;
  }
  return false;
}

bool Ground::river_near(const Rect& rect) const {
  for (const auto& body : waters) {
    if (!body.follows || !body.bounds.overlaps(rect)) continue;
    const auto& f = covers[body.grid].frame;
    const Rect wide = rect.grown(1.5 * f.spacing_m);
    for (const int cell : body.cells) {
      if (wide.contains(f.x(cell % f.columns), f.y(cell / f.columns))) return true;
    }
  }
  return false;
}

void Ground::find_waters(const world::Snapshot& world) {
  if (!world.schema().find_type("Water")) return;
  // Cells that hang together: 4-neighbours, by a stack, in the order of cells.
  const std::uint8_t water = cover_index("water");
  std::vector<std::vector<std::int32_t>> water_of_cell(covers.size());
  for (std::size_t k = 0; k < covers.size(); ++k) {
    const auto& g = covers[k];
    const int columns = g.frame.columns, rows = g.frame.rows;
    auto& body_of = water_of_cell[k];
    std::vector<int> stack;
    for (int first = 0; first < columns * rows; ++first) {
      if (g.word[g.values[first]] != water) continue;
      if (body_of.empty()) body_of.assign(g.frame.cell_count(), -1);
      if (body_of[first] >= 0) continue;
      WaterBody body;
      body.node = g.node;
      body.grid = k;
      std::vector<double> heights;
      const auto take = [&](int cell) {
        if (g.word[g.values[cell]] != water || body_of[cell] >= 0) return;
        body_of[cell] = static_cast<std::int32_t>(waters.size());
        stack.push_back(cell);
      };
      take(first);
      while (!stack.empty()) {
        const int cell = stack.back(), c = cell % columns, r = cell / columns;
        stack.pop_back();
        body.cells.push_back(cell);
        body.bounds.add(g.frame.x(c - 0.5), g.frame.y(r - 0.5));
        body.bounds.add(g.frame.x(c + 0.5), g.frame.y(r + 0.5));
        const double h = height_at(g.frame.x(c), g.frame.y(r));
        if (!std::isnan(h)) heights.push_back(h);
        if (c > 0) take(cell - 1);
        if (c + 1 < columns) take(cell + 1);
        if (r > 0) take(cell - columns);
        if (r + 1 < rows) take(cell + columns);
      }
      std::sort(body.cells.begin(), body.cells.end());
      std::sort(heights.begin(), heights.end());
      if (heights.empty()) {
        body.cells.clear();  // no ground there: nothing to lie on
        body.bounds = {};
      } else {
        const auto quantile = [&](double q) {
          return heights[static_cast<std::size_t>(q * static_cast<double>(heights.size() - 1))];
        };
        body.level_m = quantile(0.5);
        body.follows = quantile(0.95) - quantile(0.05) > kLakeRange_m;
      }
      waters.push_back(std::move(body));
    }
  }
  water_of_cell_ = std::make_shared<const std::vector<std::vector<std::int32_t>>>(std::move(water_of_cell));
  outlined_from_ = waters.size();
  const world::types::Water type(world.schema());
  auto nodes = world.nodes(type.type);
  std::sort(nodes.begin(), nodes.end());
  for (const NodeId node : nodes) {
    WaterBody body;
    body.node = node;
    body.outline = world.get_or_default(node, type.outline);
    const auto xy = body.outline.span();
    body.bounds = bounds_of(xy);
    const bool finite = std::all_of(xy.begin(), xy.end(), [](double v) { return std::isfinite(v); });
    if (xy.size() < 6 || xy.size() % 2 != 0 || !finite) {
      water_warnings_.push_back("Water " + std::to_string(node.value) +
                                ": expected an outline of at least three finite points, got " +
                                std::to_string(xy.size()) + " numbers; this water is not shown");
      continue;
    }
    body.level_m = world.get_or_default(node, type.level_m);
    if (std::isnan(body.level_m)) {
      double lowest = std::numeric_limits<double>::infinity();
      const std::size_t n = xy.size() / 2;
      for (std::size_t i = 0; i < n; ++i) {
        const std::size_t j = (i + 1) % n;
        for (int step = 0; step < 16; ++step) {
          const double t = step / 16.0;
          const double h =
              height_at(xy[2 * i] * (1 - t) + xy[2 * j] * t, xy[2 * i + 1] * (1 - t) + xy[2 * j + 1] * t);
          if (!std::isnan(h)) lowest = std::min(lowest, h);
        }
      }
      if (!std::isfinite(lowest)) {
        water_warnings_.push_back("Water " + std::to_string(node.value) +
                                  ": no level and no terrain under its outline; this water is not shown");
        continue;
      }
      body.level_m = lowest;
    }
    waters.push_back(std::move(body));
  }
}

}  // namespace rigor::nature
