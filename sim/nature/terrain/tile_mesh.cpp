#include <limits>
#include <map>

#include "sim/nature/terrain/tile.h"

namespace rigor::nature {
namespace {

enum Side { west = 0, east = 1, south = 2, north = 3 };

class Builder {
 public:
  Builder(const HeightTree& tree, const TreeNode& node, int s, const Eigen::Vector3d& origin)
      : tree_(tree), grid_(tree.grid()), node_(node), s_(s), origin_(origin), whole_(tree.span(node)) {
    const std::size_t n = (std::size_t{1} << (node.m - s)) + 1;
    shared_.assign(n * n, kNone);
    double finest = grid_.frame.spacing_m;
    for (std::size_t i = 0; i < tree.index(); ++i) {
      finest = std::min(finest, tree.ground().terrain[i].frame.spacing_m);
    }
    // Where a finer grid ends inside a cell, the cell is cut this fine.
    rivers_ = tree.ground().river_near(tree.rect(node));
    deepest_ = std::max(-6, -static_cast<int>(std::ceil(std::log2(grid_.frame.spacing_m / finest))));
  }

  TileMesh build() {
    const std::int64_t n = std::int64_t{1} << (node_.m - s_);
    for (std::int64_t j = 0; j < n; ++j) {
      for (std::int64_t i = 0; i < n; ++i) emit({s_, node_.i * n + i, node_.j * n + j}, false);
    }
    TileMesh out;
    if (mesh_->indices.empty() && river_.empty()) return out;
    out.first_river_index = static_cast<std::uint32_t>(mesh_->indices.size());
    mesh_->indices.insert(mesh_->indices.end(), river_.begin(), river_.end());
    out.mesh = std::move(mesh_);
    return out;
  }

 private:
  static constexpr std::uint32_t kNone = std::numeric_limits<std::uint32_t>::max();

  void emit(const TreeNode& b, bool inside_mixed) {
    const Share share = tree_.drawn(b);
    if (share == Share::none) return;
    if (share == Share::part && b.m > deepest_) {
      for (int k = 0; k < 4; ++k) emit({b.m - 1, 2 * b.i + (k & 1), 2 * b.j + (k >> 1)}, true);
      return;
    }
    const auto s = tree_.span(b);
    if (s.empty()) return;
    const std::uint32_t nw = vertex(s.u0, s.v0, b, 0, 0), ne = vertex(s.u1, s.v0, b, 1, 0),
                        sw = vertex(s.u0, s.v1, b, 0, 1), se = vertex(s.u1, s.v1, b, 1, 1);
    const bool river = rivers_ && tree_.ground().is_river(grid_.frame.x((s.u0 + s.u1) / 2),
                                                          grid_.frame.y((s.v0 + s.v1) / 2));
    auto& indices = river ? river_ : mesh_->indices;
    for (const std::uint32_t v : {nw, sw, se, nw, se, ne}) indices.push_back(v);
    side(b, s, west, nw, sw, inside_mixed);
    side(b, s, east, se, ne, inside_mixed);
    side(b, s, south, sw, se, inside_mixed);
    side(b, s, north, ne, nw, inside_mixed);
  }

  /// a to b: anticlockwise around the block as seen from above.
  void side(const TreeNode& b, const HeightTree::Span& s, Side which, std::uint32_t a, std::uint32_t c,
            bool inside_mixed) {
    const bool on_node_edge = which == west    ? s.u0 <= whole_.u0
                              : which == east  ? s.u1 >= whole_.u1
                              : which == south ? s.v1 >= whole_.v1
                                               : s.v0 <= whole_.v0;
    const TreeNode beside{b.m, b.i + (which == east) - (which == west),
                          b.j + (which == south) - (which == north)};
    const bool outside = beside.i < 0 || beside.j < 0 || tree_.span(beside).empty();
    const Share there = outside ? Share::none : tree_.drawn(beside);
    if (there == Share::none) {
      wall(a, c);
      return;
    }
    if (!on_node_edge && !inside_mixed && there == Share::all) return;  // the neighbour shares the edge
    const TreeNode& along = on_node_edge && !inside_mixed ? node_ : widest(b);
    double low = tree_.lowest_on_side(along, which);
    // Under an edge inside the node, blocks of any size up to 2^s cells may meet.
    if (!on_node_edge || inside_mixed) {
      const auto range = tree_.range_m(along);
      low = std::min(low, static_cast<double>(range.low));
    }
    if (!std::isfinite(low)) return;
    const auto bottom =
        static_cast<float>(low - origin_.z() - 0.01 - 1e-3 * std::ldexp(grid_.frame.spacing_m, b.m));
    const std::uint32_t a2 = lowered(a, bottom), c2 = lowered(c, bottom);
    for (const std::uint32_t v : {a, a2, c2, a, c2, c}) mesh_->indices.push_back(v);
  }

  /// The block of 2^s cells in which a smaller one lies.
  [[nodiscard]] TreeNode widest(const TreeNode& b) const {
    return b.m >= s_ ? b : TreeNode{s_, b.i >> (s_ - b.m), b.j >> (s_ - b.m)};
  }

  /// Where this grid ends and a coarser one shows, a wall between the two.
  void wall(std::uint32_t a, std::uint32_t c) {
    const auto coarser = [&](std::uint32_t v) {
      const float* p = mesh_->vertices[v].position;
      return tree_.ground().height_at(p[0] + origin_.x(), p[1] + origin_.y(), tree_.index() + 1);
    };
    if (tree_.index() + 1 >= tree_.ground().terrain.size()) return;
    const double za = coarser(a), zc = coarser(c);
    if (std::isnan(za) || std::isnan(zc)) return;
    const auto reach = [&](std::uint32_t v, double z) {
      const double relative = z - origin_.z();
      return lowered(
          v, static_cast<float>(relative < mesh_->vertices[v].position[2] ? relative - 0.05 : relative));
    };
    const std::uint32_t a2 = reach(a, za), c2 = reach(c, zc);
    for (const std::uint32_t v : {a, a2, c2, a, c2, c, a, c2, a2, a, c, c2}) mesh_->indices.push_back(v);
  }

  std::uint32_t lowered(std::uint32_t of, float z) {
    render::Vertex v = mesh_->vertices[of];
    v.position[2] = z;
    mesh_->vertices.push_back(v);
    return static_cast<std::uint32_t>(mesh_->vertices.size() - 1);
  }

  std::uint32_t vertex(double u, double v, const TreeNode& b, int di, int dj) {
    if (b.m != s_) return fresh(u, v);
    const std::int64_t n = std::int64_t{1} << (node_.m - s_);
    std::uint32_t& known =
        shared_[static_cast<std::size_t>((b.j - node_.j * n + dj) * (n + 1) + b.i - node_.i * n + di)];
    if (known == kNone) known = fresh(u, v);
    return known;
  }

  std::uint32_t fresh(double u, double v) {
    const auto& f = grid_.frame;
    const Eigen::Vector2d slope = grid_slope(grid_, u, v);
    const Eigen::Vector3d normal = Eigen::Vector3d(-slope.x(), -slope.y(), 1).normalized();
    const double size = std::ldexp(1.0, node_.m);
    const auto texture = [](double t) {
      return static_cast<float>((0.5 + t * (kTileTexels - 1)) / kTileTexels);
    };
    render::Vertex out{};
    out.position[0] = static_cast<float>(f.x(u) - origin_.x());
    out.position[1] = static_cast<float>(f.y(v) - origin_.y());
    out.position[2] = static_cast<float>(grid_height(grid_, u, v) - origin_.z());
    for (int k = 0; k < 3; ++k) out.normal[k] = static_cast<float>(normal[k]);
    out.uv[0] = texture(u / size - static_cast<double>(node_.i));
    out.uv[1] = texture(v / size - static_cast<double>(node_.j));
    mesh_->vertices.push_back(out);
    return static_cast<std::uint32_t>(mesh_->vertices.size() - 1);
  }

  const HeightTree& tree_;
  const HeightGrid& grid_;
  TreeNode node_;
  int s_, deepest_ = 0;
  Eigen::Vector3d origin_;
  HeightTree::Span whole_;
  std::shared_ptr<render::Mesh> mesh_ = std::make_shared<render::Mesh>();
  std::vector<std::uint32_t> shared_, river_;
  bool rivers_ = false;
};

void finish(render::Mesh& mesh) {
  mesh.bounds.setEmpty();
  for (const auto& v : mesh.vertices)
    mesh.bounds.extend(Eigen::Vector3f(v.position[0], v.position[1], v.position[2]));
}

/// Ear clipping; the outline may run either way round.
std::vector<std::uint32_t> triangulate(std::span<const double> xy) {
  const auto n = static_cast<std::uint32_t>(xy.size() / 2);
  double area = 0;
  for (std::uint32_t i = 0, j = n - 1; i < n; j = i++)
    area += xy[2 * j] * xy[2 * i + 1] - xy[2 * i] * xy[2 * j + 1];
  std::vector<std::uint32_t> ring(n), out;
  for (std::uint32_t i = 0; i < n; ++i) ring[i] = area >= 0 ? i : n - 1 - i;
  const auto cross = [&](std::uint32_t a, std::uint32_t b, std::uint32_t c) {
    return (xy[2 * b] - xy[2 * a]) * (xy[2 * c + 1] - xy[2 * a + 1]) -
           (xy[2 * b + 1] - xy[2 * a + 1]) * (xy[2 * c] - xy[2 * a]);
  };
  while (ring.size() > 2) {
    bool cut = false;
    for (std::size_t i = 0; i < ring.size() && !cut; ++i) {
      const std::uint32_t a = ring[(i + ring.size() - 1) % ring.size()], b = ring[i],
                          c = ring[(i + 1) % ring.size()];
      const double turn = cross(a, b, c);
      if (turn < 0) continue;
      bool ear = true;
      for (const std::uint32_t p : ring) {
        if (p == a || p == b || p == c) continue;
        if (cross(a, b, p) > 0 && cross(b, c, p) > 0 && cross(c, a, p) > 0) {
          ear = false;
          break;
        }
      }
      if (!ear) continue;
      if (turn > 0) out.insert(out.end(), {a, b, c});
      ring.erase(ring.begin() + static_cast<std::ptrdiff_t>(i));
      cut = true;
    }
    if (!cut) break;  // an outline that crosses itself: the rest has no inside
  }
  return out;
}

}  // namespace

TileMesh tile_mesh(const HeightTree& tree, const TreeNode& node, int s, const Eigen::Vector3d& origin) {
  TileMesh out = Builder(tree, node, std::min(s, node.m), origin).build();
  if (out.mesh) finish(*out.mesh);
  return out;
}

std::shared_ptr<render::Mesh> water_mesh(const Ground& ground, const WaterBody& body,
                                         const Eigen::Vector3d& origin) {
  if (body.follows) return nullptr;
  auto mesh = std::make_shared<render::Mesh>();
  const auto add = [&](double x, double y) {
    render::Vertex v{};
    const Eigen::Vector3d p = Eigen::Vector3d(x, y, body.level_m) - origin;
    for (int k = 0; k < 3; ++k) v.position[k] = static_cast<float>(p[k]);
    v.normal[2] = 1;
    v.uv[0] = v.position[0];
    v.uv[1] = v.position[1];
    mesh->vertices.push_back(v);
    return static_cast<std::uint32_t>(mesh->vertices.size() - 1);
  };
  if (!body.outline.empty()) {
    const auto xy = body.outline.span();
    for (std::size_t i = 0; i + 1 < xy.size(); i += 2) add(xy[i], xy[i + 1]);
    mesh->indices = triangulate(xy);
  } else {
    // Rows of cells, each with the cells around: the sheet ends under the shore, not at a cell's edge.
    const auto& f = ground.covers[body.grid].frame;
    std::map<int, std::vector<std::pair<int, int>>> runs;  // row → [first, last] columns, ascending
    for (const int cell : body.cells) {
      const int c = cell % f.columns, r = cell / f.columns;
      for (int row = std::max(r - 1, 0); row <= std::min(r + 1, f.rows - 1); ++row) {
        runs[row].emplace_back(std::max(c - 1, 0), std::min(c + 1, f.columns - 1));
      }
    }
    for (auto& [row, parts] : runs) {
      std::sort(parts.begin(), parts.end());
      for (std::size_t i = 0; i < parts.size();) {
        int last = parts[i].second;
        std::size_t k = i + 1;
        for (; k < parts.size() && parts[k].first <= last + 1; ++k) last = std::max(last, parts[k].second);
        const double x0 = f.x(parts[i].first - 0.5), x1 = f.x(last + 0.5), y0 = f.y(row + 0.5),
                     y1 = f.y(row - 0.5);
        const std::uint32_t sw = add(x0, y0), se = add(x1, y0), ne = add(x1, y1), nw = add(x0, y1);
        for (const std::uint32_t v : {nw, sw, se, nw, se, ne}) mesh->indices.push_back(v);
        i = k;
      }
    }
  }
  if (mesh->indices.empty()) return nullptr;
  finish(*mesh);
  return mesh;
}

}  // namespace rigor::nature
