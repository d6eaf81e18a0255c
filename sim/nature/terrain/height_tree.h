// What levels of detail of one height grid are worth: for every block of 2^s x 2^s cells, drawn as two
// triangles (split from north-west to south-east), how far these deviate from the bilinear surface, exactly;
// its lowest and highest point; and how much of it is drawn at all.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "sim/nature/terrain/ground.h"

namespace rigor::nature {

/// A square of the quadtree over a grid: 2^m cells wide, from (i·2^m, j·2^m); m < 0: a part of one cell.
struct TreeNode {
  int m = 0;
  std::int64_t i = 0, j = 0;
  bool operator==(const TreeNode&) const = default;
};

class HeightTree {
 public:
  /// `index`: of the grid in `ground`, both kept alive by the caller.
  HeightTree(std::shared_ptr<const Ground> ground, std::size_t index);

  [[nodiscard]] const HeightGrid& grid() const { return ground_->terrain[index_]; }
  [[nodiscard]] const Ground& ground() const { return *ground_; }
  [[nodiscard]] std::size_t index() const { return index_; }
  [[nodiscard]] TreeNode root() const { return {top_, 0, 0}; }
  /// Cells from u0 to u1 and v0 to v1 of a node, cut at the grid's edge. Without area outside.
  struct Span {
    double u0, v0, u1, v1;
    [[nodiscard]] bool empty() const { return u1 <= u0 || v1 <= v0; }
  };
  [[nodiscard]] Span span(const TreeNode& n) const;
  [[nodiscard]] Rect rect(const TreeNode& n) const;

  /// How much of a block of 2^s cells is drawn. Holes, what finer grids show, and beds of waters are not.
  [[nodiscard]] Share drawn(const TreeNode& block) const;
  /// Largest vertical distance, over the block's part of the grid, between the bilinear surface and what is
  /// drawn of it with blocks of 2^s cells (fewer at holes); never smaller than that of a part of it.
  [[nodiscard]] double error_m(const TreeNode& block) const;
  /// The same for a node drawn in blocks of 2^s ≤ 2^m cells.
  [[nodiscard]] double error_m(const TreeNode& node, int s) const;
  /// Lowest and highest height; inverted where there is none.
  struct Range {
    float low, high;
  };
  [[nodiscard]] Range range_m(const TreeNode& node) const;
  /// Lowest height on a side of a node (0 west, 1 east, 2 south, 3 north); NaN: none.
  [[nodiscard]] double lowest_on_side(const TreeNode& node, int side) const;

  /// Takes over a new ground in which heights of this grid differ within `rects` alone, and what is drawn
  /// within `redrawn`.
  void update(std::shared_ptr<const Ground> ground, std::size_t index, const std::vector<Rect>& rects);

 private:
  struct Block {
    float low, high, error;
    Share drawn;
  };
  struct Level {
    int columns = 0, rows = 0;
    std::vector<Block> blocks;
  };
  static constexpr int kFirstStored = 2;  // smaller blocks are looked at anew each time
  struct Cells {
    int c0, r0, c1, r1;  // the vertices c0..c1, r0..r1
  };
  [[nodiscard]] Cells cells(const TreeNode& block) const;
  [[nodiscard]] double own_error(const Cells& k) const;
  [[nodiscard]] double twist(int c, int r) const;
  void find_drawn(const Rect* within);
  [[nodiscard]] Share find_drawn_quad(int c, int r) const;
  void compute(int s, int bi, int bj);
  [[nodiscard]] const Block& stored(const TreeNode& b) const;

  std::shared_ptr<const Ground> ground_;
  std::size_t index_;
  int top_ = 0;
  std::vector<Share> quads_;  ///< empty: all drawn
  std::vector<Level> levels_;
};

}  // namespace rigor::nature
