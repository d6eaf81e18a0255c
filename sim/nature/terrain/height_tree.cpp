#include "sim/nature/terrain/height_tree.h"

#include <bit>
#include <limits>

namespace rigor::nature {
namespace {

constexpr float kInf = std::numeric_limits<float>::infinity();

TreeNode child(const TreeNode& n, int k) { return {n.m - 1, 2 * n.i + (k & 1), 2 * n.j + (k >> 1)}; }

}  // namespace

HeightTree::HeightTree(std::shared_ptr<const Ground> ground, std::size_t index)
    : ground_(std::move(ground)), index_(index) {
  const auto& f = grid().frame;
  const auto cells_across = static_cast<unsigned>(std::max(f.columns, f.rows) - 1);
  top_ = std::bit_width(cells_across - 1);  // 2^top ≥ cells across
  find_drawn(nullptr);
  for (int s = kFirstStored; s <= top_; ++s) {
    Level level;
    level.columns = ((f.columns - 2) >> s) + 1;
    level.rows = ((f.rows - 2) >> s) + 1;
    level.blocks.resize(static_cast<std::size_t>(level.columns) * level.rows);
    levels_.push_back(std::move(level));
    for (int j = 0; j < levels_.back().rows; ++j) {
      for (int i = 0; i < levels_.back().columns; ++i) compute(s, i, j);
    }
  }
}

HeightTree::Span HeightTree::span(const TreeNode& n) const {
  const auto& f = grid().frame;
  const double size = std::ldexp(1.0, n.m);
  const auto cut = [&](std::int64_t k, int cells) {
    return std::min(static_cast<double>(k) * size, cells - 1.0);
  };
  return {cut(n.i, f.columns), cut(n.j, f.rows), cut(n.i + 1, f.columns), cut(n.j + 1, f.rows)};
}

Rect HeightTree::rect(const TreeNode& n) const {
  const Span s = span(n);
  const auto& f = grid().frame;
  return {f.x(s.u0), f.y(s.v1), f.x(s.u1), f.y(s.v0)};
}

HeightTree::Cells HeightTree::cells(const TreeNode& b) const {
  const auto& f = grid().frame;
  const std::int64_t size = std::int64_t{1} << b.m;
  const auto cut = [](std::int64_t v, int most) { return static_cast<int>(std::min<std::int64_t>(v, most)); };
  return {cut(b.i * size, f.columns - 1), cut(b.j * size, f.rows - 1), cut((b.i + 1) * size, f.columns - 1),
          cut((b.j + 1) * size, f.rows - 1)};
}

const HeightTree::Block& HeightTree::stored(const TreeNode& b) const {
  const Level& level = levels_[b.m - kFirstStored];
  return level.blocks[static_cast<std::size_t>(b.j) * level.columns + b.i];
}

double HeightTree::twist(int c, int r) const {
  const auto& g = grid();
  return static_cast<double>(g.at(c, r)) + g.at(c + 1, r + 1) - g.at(c + 1, r) - g.at(c, r + 1);
}

// What is drawn is linear on each of two triangles, the surface bilinear on each cell. Their difference on a
// piece of a cell is bilinear, a saddle without extrema inside, and linear along the cell's edges. So its
// extrema are at the grid's points, and along the diagonal, where it is a parabola between the grid lines.
double HeightTree::own_error(const Cells& k) const {
  const auto& g = grid();
  const int w = k.c1 - k.c0, h = k.r1 - k.r0;
  if (w <= 0 || h <= 0) return 0;
  const double nw = g.at(k.c0, k.r0), ne = g.at(k.c1, k.r0), sw = g.at(k.c0, k.r1), se = g.at(k.c1, k.r1);
  double worst = 0;
  for (int r = 0; r <= h; ++r) {
    const double q = static_cast<double>(r) / h;
    for (int c = 0; c <= w; ++c) {
      const double p = static_cast<double>(c) / w;
      const double drawn = p >= q ? nw + (ne - nw) * p + (se - ne) * q : nw + (sw - nw) * q + (se - sw) * p;
      worst = std::max(worst, std::abs(g.at(k.c0 + c, k.r0 + r) - drawn));
    }
  }
  const auto along = [&](double t) {
    return grid_height(g, k.c0 + t * w, k.r0 + t * h) - (nw + (se - nw) * t);
  };
  double t0 = 0, f0 = 0;
  for (int i = 1, j = 1; i <= w || j <= h;) {
    const double ti = i <= w ? static_cast<double>(i) / w : 2, tj = j <= h ? static_cast<double>(j) / h : 2;
    const double t1 = std::min(ti, tj);
    i += ti <= t1 ? 1 : 0;
    j += tj <= t1 ? 1 : 0;
    const double f1 = along(t1), middle = along((t0 + t1) / 2);
    const double a = 2 * (f0 + f1 - 2 * middle), b = f1 - f0 - a;  // f0 + b·x + a·x², 0 ≤ x ≤ 1
    worst = std::max(worst, std::abs(f1));
    if (a != 0) {
      const double x = -b / (2 * a);
      if (x > 0 && x < 1) worst = std::max(worst, std::abs(f0 + b * x + a * x * x));
    }
    t0 = t1;
    f0 = f1;
  }
  return worst;
}

Share HeightTree::find_drawn_quad(int c, int r) const {
  const auto& g = grid();
  if (!quad_valid(g, c, r)) return Share::none;
  const Share finer = index_ == 0 ? Share::none
                                  : ground_->covered_by_finer(index_, {g.frame.x(c), g.frame.y(r + 1),
                                                                       g.frame.x(c + 1), g.frame.y(r)});
  if (finer == Share::all) return Share::none;
  bool bed = !ground_->waters.empty();
  for (int k = 0; k < 4 && bed; ++k) {
    const int cc = c + (k & 1), rr = r + (k >> 1);
    bed = ground_->under_sheet(g.frame.x(cc), g.frame.y(rr), g.at(cc, rr));
  }
  if (bed) return Share::none;
  return finer == Share::part ? Share::part : Share::all;
}

void HeightTree::find_drawn(const Rect* within) {
  const auto& f = grid().frame;
  const int columns = f.columns - 1, rows = f.rows - 1;
  int c0 = 0, r0 = 0, c1 = columns, r1 = rows;
  if (within) {
    c0 = static_cast<int>(std::clamp(std::floor(f.u(within->x0)) - 1, 0.0, columns + 0.0));
    c1 = static_cast<int>(std::clamp(std::ceil(f.u(within->x1)) + 1, 0.0, columns + 0.0));
    r0 = static_cast<int>(std::clamp(std::floor(f.v(within->y1)) - 1, 0.0, rows + 0.0));
    r1 = static_cast<int>(std::clamp(std::ceil(f.v(within->y0)) + 1, 0.0, rows + 0.0));
  }
  for (int r = r0; r < r1; ++r) {
    for (int c = c0; c < c1; ++c) {
      const Share share = find_drawn_quad(c, r);
      if (share == Share::all && quads_.empty()) continue;
      if (quads_.empty()) quads_.assign(static_cast<std::size_t>(columns) * rows, Share::all);
      quads_[static_cast<std::size_t>(r) * columns + c] = share;
    }
  }
}

Share HeightTree::drawn(const TreeNode& b) const {
  if (span(b).empty()) return Share::none;
  if (b.m >= kFirstStored) return stored(b).drawn;
  if (b.m < 0) {
    const int c = static_cast<int>(b.i >> -b.m), r = static_cast<int>(b.j >> -b.m);
    const Share quad = drawn(TreeNode{0, c, r});
    if (quad != Share::part) return quad;
    const Share finer = ground_->covered_by_finer(index_, rect(b));
    return finer == Share::all ? Share::none : finer == Share::none ? Share::all : Share::part;
  }
  if (quads_.empty()) return Share::all;
  const Cells k = cells(b);
  int all = 0, none = 0, seen = 0;
  for (int r = k.r0; r < k.r1; ++r) {
    for (int c = k.c0; c < k.c1; ++c, ++seen) {
      const Share s = quads_[static_cast<std::size_t>(r) * (grid().frame.columns - 1) + c];
      all += s == Share::all;
      none += s == Share::none;
    }
  }
  return all == seen ? Share::all : none == seen ? Share::none : Share::part;
}

double HeightTree::error_m(const TreeNode& b) const {
  if (span(b).empty()) return 0;
  if (b.m >= kFirstStored) return stored(b).error;
  if (b.m < 0) {
    const int c = static_cast<int>(b.i >> -b.m), r = static_cast<int>(b.j >> -b.m);
    return quad_valid(grid(), c, r) ? std::ldexp(std::abs(twist(c, r)) / 4, 2 * b.m) : 0;
  }
  const Share share = drawn(b);
  if (share == Share::none) return 0;
  if (b.m == 0) return std::abs(twist(static_cast<int>(b.i), static_cast<int>(b.j))) / 4;
  double worst = share == Share::all ? own_error(cells(b)) : 0;
  for (int k = 0; k < 4; ++k) worst = std::max(worst, error_m(child(b, k)));
  return worst;
}

double HeightTree::error_m(const TreeNode& node, int s) const {
  if (s >= node.m) return error_m(node);
  if (s < 0 && node.m >= 0) {  // parts of a cell deviate by its twist
    const Cells k = cells(node);
    double most = 0;
    for (int r = k.r0; r < k.r1; ++r) {
      for (int c = k.c0; c < k.c1; ++c) {
        if (quad_valid(grid(), c, r)) most = std::max(most, std::abs(twist(c, r)) / 4);
      }
    }
    return std::ldexp(most, 2 * s);
  }
  if (s < 0) return error_m(TreeNode{s, node.i << (node.m - s), node.j << (node.m - s)});
  double worst = 0;
  const std::int64_t n = std::int64_t{1} << (node.m - s);
  for (std::int64_t j = 0; j < n; ++j) {
    for (std::int64_t i = 0; i < n; ++i) {
      worst = std::max(worst, error_m(TreeNode{s, node.i * n + i, node.j * n + j}));
    }
  }
  return worst;
}

HeightTree::Range HeightTree::range_m(const TreeNode& node) const {
  Range out{kInf, -kInf};
  const Span s = span(node);
  if (s.empty()) return out;
  if (node.m >= kFirstStored) return {stored(node).low, stored(node).high};
  const auto take = [&](float h) {
    if (!std::isfinite(h)) return;
    out.low = std::min(out.low, h);
    out.high = std::max(out.high, h);
  };
  if (node.m < 0) {
    for (int k = 0; k < 4; ++k) {
      take(static_cast<float>(grid_height(grid(), k & 1 ? s.u1 : s.u0, k & 2 ? s.v1 : s.v0)));
    }
    return out;
  }
  const Cells k = cells(node);
  for (int r = k.r0; r <= k.r1; ++r) {
    for (int c = k.c0; c <= k.c1; ++c) take(grid().at(c, r));
  }
  return out;
}

double HeightTree::lowest_on_side(const TreeNode& node, int side) const {
  const Span s = span(node);
  double lowest = std::numeric_limits<double>::infinity();
  const auto take = [&](double u, double v) {
    const double h = grid_height(grid(), u, v);
    if (!std::isnan(h)) lowest = std::min(lowest, h);
  };
  const bool along_v = side < 2;
  const double fixed = side == 0 ? s.u0 : side == 1 ? s.u1 : side == 2 ? s.v1 : s.v0;
  const double from = along_v ? s.v0 : s.u0, to = along_v ? s.v1 : s.u1;
  for (double t = from;; t = std::min(std::floor(t) + 1, to)) {
    along_v ? take(fixed, t) : take(t, fixed);
    if (t >= to) break;
  }
  return std::isfinite(lowest) ? lowest : std::numeric_limits<double>::quiet_NaN();
}

void HeightTree::compute(int s, int bi, int bj) {
  Level& level = levels_[s - kFirstStored];
  Block& out = level.blocks[static_cast<std::size_t>(bj) * level.columns + bi];
  out = {kInf, -kInf, 0, Share::none};
  const TreeNode b{s, bi, bj};
  const Cells k = cells(b);
  int all = 0, none = 0, seen = 0;
  for (int part = 0; part < 4; ++part) {
    const TreeNode c = child(b, part);
    if (span(c).empty()) continue;
    ++seen;
    const Share d = drawn(c);
    all += d == Share::all;
    none += d == Share::none;
    out.error = std::max(out.error, static_cast<float>(error_m(c)));
    const Range z = range_m(c);
    out.low = std::min(out.low, z.low);
    out.high = std::max(out.high, z.high);
  }
  out.drawn = all == seen ? Share::all : none == seen ? Share::none : Share::part;
  if (out.drawn == Share::all) {
    // Rounded up, so that float never understates it.
    out.error = std::max(out.error, std::nextafter(static_cast<float>(own_error(k)), kInf));
  }
}

void HeightTree::update(std::shared_ptr<const Ground> ground, std::size_t index,
                        const std::vector<Rect>& rects) {
  ground_ = std::move(ground);
  index_ = index;
  const auto& f = grid().frame;
  for (const Rect& rect : rects) {
    if (!rect.overlaps(f.cells())) continue;
    find_drawn(&rect);
    for (int s = kFirstStored; s <= top_; ++s) {
      const Level& level = levels_[s - kFirstStored];
      const auto block = [&](double cell, int most) {
        return static_cast<int>(std::clamp(std::floor(std::ldexp(cell, -s)), 0.0, most - 1.0));
      };
      const int i0 = block(f.u(rect.x0) - 1.5, level.columns), i1 = block(f.u(rect.x1) + 1.5, level.columns);
      const int j0 = block(f.v(rect.y1) - 1.5, level.rows), j1 = block(f.v(rect.y0) + 1.5, level.rows);
      for (int j = j0; j <= j1; ++j) {
        for (int i = i0; i <= i1; ++i) compute(s, i, j);
      }
    }
  }
}

}  // namespace rigor::nature
