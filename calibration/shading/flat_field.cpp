#include "calibration/shading/flat_field.h"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>

namespace rigor::calibration {
namespace {

struct Sample {
  double x, y, value;
};

/// Mean of a plane through the cell at its middle, what lies beyond four deviations left out.
bool cell_of(std::vector<Sample>& samples, double x0, double y0, double size, ShadingCell& cell) {
  Eigen::Vector3d plane(0, 0, 0);
  double limit = 1e300, sigma = 0;
  for (int round = 0; round < 6; ++round) {
    Eigen::Matrix3d a = Eigen::Matrix3d::Zero();
    Eigen::Vector3d b = Eigen::Vector3d::Zero();
    double number = 0, rest = 0;
    std::vector<double> residual;
    const auto used = [&](const Sample& s) {
      return std::abs(s.value - plane.dot(Eigen::Vector3d(1, s.x - x0, s.y - y0))) <= limit;
    };
    std::vector<Sample> kept;
    for (const Sample& s : samples)
      if (round == 0 || used(s)) kept.push_back(s);
    for (const Sample& s : kept) {
      const Eigen::Vector3d row(1, s.x - x0, s.y - y0);
      a += row * row.transpose();
      b += row * s.value;
      ++number;
    }
    if (number < 12) return false;
    plane = a.ldlt().solve(b);
    for (const Sample& s : kept) {
      const double e = s.value - plane.dot(Eigen::Vector3d(1, s.x - x0, s.y - y0));
      rest += e * e;
      residual.push_back(std::abs(e));
    }
    const auto middle = residual.begin() + static_cast<std::ptrdiff_t>(residual.size() / 2);
    std::nth_element(residual.begin(), middle, residual.end());
    limit = std::max(4 * 1.4826 * *middle, 1e-9 * std::abs(plane[0]));
    sigma = std::sqrt(rest / (number - 3) * a.inverse()(0, 0));
  }
  cell = {x0, y0, plane[0], sigma, size};
  return plane[0] > 0;
}

}  // namespace

Result<std::vector<ShadingCell>> flat_field_cells(std::span<const double> mean_dn, int width_px,
                                                  int height_px, double black_dn, bool mosaic, int columns) {
  const auto w = static_cast<std::size_t>(width_px), h = static_cast<std::size_t>(height_px);
  if (width_px < 16 || height_px < 16 || mean_dn.size() != w * h)
    return fail(ErrorCode::bad_input, "",
                "expected a flat field of 16x16 pixels or more, got " + std::to_string(width_px) + "x" +
                    std::to_string(height_px));
  std::array<double, 4> level{}, number{};
  for (std::size_t y = 0; y < h; ++y)
    for (std::size_t x = 0; x < w; ++x) {
      const std::size_t k = mosaic ? (y & 1) * 2 + (x & 1) : 0;
      level[k] += mean_dn[y * w + x] - black_dn;
      ++number[k];
    }
  for (std::size_t k = 0; k < 4; ++k) {
    if (number[k] == 0) continue;
    level[k] /= number[k];
    if (!(level[k] > 0))
      return fail(ErrorCode::bad_input, "",
                  "expected a flat field above the black level of " + std::to_string(black_dn) +
                      " DN, got a mean of " + std::to_string(level[k] + black_dn) + " DN");
  }
  const double side = static_cast<double>(width_px) / columns;
  const int rows = std::max(1, static_cast<int>(std::lround(height_px / side)));
  std::vector<ShadingCell> cells;
  std::vector<Sample> samples;
  for (int r = 0; r < rows; ++r)
    for (int c = 0; c < columns; ++c) {
      const auto x_from = static_cast<std::size_t>(c * width_px / columns),
                 x_to = static_cast<std::size_t>((c + 1) * width_px / columns);
      const auto y_from = static_cast<std::size_t>(r * height_px / rows),
                 y_to = static_cast<std::size_t>((r + 1) * height_px / rows);
      samples.clear();
      for (std::size_t y = y_from; y < y_to; ++y)
        for (std::size_t x = x_from; x < x_to; ++x) {
          const std::size_t k = mosaic ? (y & 1) * 2 + (x & 1) : 0;
          samples.push_back({double(x), double(y), (mean_dn[y * w + x] - black_dn) / level[k]});
        }
      ShadingCell cell;
      if (cell_of(samples, 0.5 * static_cast<double>(x_from + x_to - 1),
                  0.5 * static_cast<double>(y_from + y_to - 1), side, cell))
        cells.push_back(cell);
    }
  return cells;
}

Result<std::vector<ShadingCell>> gain_table_cells(std::span<const double> gains, int columns, int width_px,
                                                  int height_px) {
  if (columns < 4 || gains.size() % static_cast<std::size_t>(columns) != 0 ||
      gains.size() / static_cast<std::size_t>(columns) < 4)
    return fail(ErrorCode::bad_input, "",
                "expected a table of gains of at least 4 by 4, got " + std::to_string(gains.size()) +
                    " numbers in " + std::to_string(columns) + " columns");
  const auto rows = gains.size() / static_cast<std::size_t>(columns);
  std::vector<ShadingCell> cells;
  for (std::size_t i = 0; i < gains.size(); ++i) {
    if (!(gains[i] > 0) || !std::isfinite(gains[i]))
      return fail(ErrorCode::bad_input, "", "expected gains above 0, got " + std::to_string(gains[i]));
    const double c = static_cast<double>(i % static_cast<std::size_t>(columns));
    const double r = static_cast<double>(i / static_cast<std::size_t>(columns));
    cells.push_back({(c + 0.5) * width_px / columns - 0.5,
                     (r + 0.5) * height_px / static_cast<double>(rows) - 0.5, 1 / gains[i], 0, 0});
  }
  return cells;
}

}  // namespace rigor::calibration
