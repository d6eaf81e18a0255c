// The stems that are known: where they stand in the world, how thick they are, which are marked for felling.
//
// Files, by their ending:
//   .csv    a header with the columns x_m, y_m, diameter_m and, where there are any, fell (true, false)
//   .yaml   stems: [ { x_m: 1.5, y_m: -2, diameter_m: 0.3, fell: true }, … ]
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <limits>
#include <span>
#include <vector>

#include "rt-core/result.h"

namespace rigor::forest {

struct Stem {
  double x_m = 0, y_m = 0, radius_m = 0;
  bool fell = false;
};

/// Two stems and their distance; for finding a constellation again.
struct StemPair {
  float distance_m = 0;
  std::uint32_t a = 0, b = 0;
};

/// Made in the setup context; does not change. Look-ups: any thread, no allocation.
class StemMap {
 public:
  static constexpr std::size_t kMaxStems = 20000;
  static constexpr std::size_t kMaxPairs = 2'000'000;
  static constexpr std::uint32_t kNone = std::numeric_limits<std::uint32_t>::max();

  /// not_found; bad_input with the file and, where it has one, the line.
  [[nodiscard]] static Result<StemMap> load(const std::filesystem::path& file);
  /// `where` goes into messages. Too many stems, or one without extent: bad_input.
  [[nodiscard]] static Result<StemMap> from(std::vector<Stem> stems, const std::string& where = "stem map");

  [[nodiscard]] std::size_t size() const noexcept { return stems_.size(); }
  [[nodiscard]] const Stem& operator[](std::size_t i) const noexcept { return stems_[i]; }
  [[nodiscard]] std::span<const Stem> stems() const noexcept { return stems_; }
  /// The nearest stem within `limit_m`, or kNone.
  [[nodiscard]] std::uint32_t nearest(double x_m, double y_m, double limit_m) const noexcept;
  /// f(index) for every stem within `limit_m`, in the order of the grid.
  template <class F>
  void near(double x_m, double y_m, double limit_m, F&& f) const noexcept {
    if (stems_.empty()) return;
    const std::size_t c0 = column(x_m - limit_m), c1 = column(x_m + limit_m);
    const std::size_t r0 = row(y_m - limit_m), r1 = row(y_m + limit_m);
    for (std::size_t r = r0; r <= r1; ++r)
      for (std::uint32_t k = cell_begin_[r * columns_ + c0]; k < cell_begin_[r * columns_ + c1 + 1]; ++k) {
        const Stem& s = stems_[order_[k]];
        const double dx = s.x_m - x_m, dy = s.y_m - y_m;
        if (dx * dx + dy * dy <= limit_m * limit_m) f(order_[k]);
      }
  }
  /// Pairs up to `pair_limit_m` apart, by distance.
  [[nodiscard]] std::span<const StemPair> pairs_between(double from_m, double to_m) const noexcept;
  [[nodiscard]] double pair_limit_m() const noexcept { return pair_limit_m_; }
  /// Stems per square metre of the bounding box, grown by 5 m on each side.
  [[nodiscard]] double density_per_m2() const noexcept { return density_; }

 private:
  [[nodiscard]] std::size_t column(double x_m) const noexcept { return cell(x_m - min_x_, columns_); }
  [[nodiscard]] std::size_t row(double y_m) const noexcept { return cell(y_m - min_y_, rows_); }
  [[nodiscard]] std::size_t cell(double from_begin_m, std::size_t count) const noexcept {
    if (!(from_begin_m > 0)) return 0;
    const double i = from_begin_m / cell_m_;
    return i < static_cast<double>(count - 1) ? static_cast<std::size_t>(i) : count - 1;
  }

  std::vector<Stem> stems_;
  std::vector<StemPair> pairs_;
  std::vector<std::uint32_t> cell_begin_, order_;
  double min_x_ = 0, min_y_ = 0, cell_m_ = 2, density_ = 0, pair_limit_m_ = 15;
  std::size_t columns_ = 1, rows_ = 1;
};

}  // namespace rigor::forest
