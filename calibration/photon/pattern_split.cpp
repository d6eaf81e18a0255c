#include "calibration/photon/pattern_split.h"

#include <cmath>

namespace rigor::calibration {
namespace {

/// Quadratic over five (Savitzky & Golay 1964): what a line keeps of its own variance, and what neighbours
/// that share a mean cost in certainty.
constexpr double kSmooth[5] = {-3.0 / 35, 12.0 / 35, 17.0 / 35, 12.0 / 35, -3.0 / 35};
constexpr double kKept = 1 - 17.0 / 35;

double correlation() {
  double filter[13] = {}, sum = 0, centre = 0;
  for (int i = 0; i < 5; ++i) filter[4 + i] = -kSmooth[i];
  filter[6] += 1;
  for (int d = -4; d <= 4; ++d) {
    double c = 0;
    for (int i = 0; i < 13; ++i)
      if (i + d >= 0 && i + d < 13) c += filter[i] * filter[i + d];
    if (d == 0) centre = c;
    sum += c * c;
  }
  return sum / (centre * centre);
}

/// Variance of the lines' own offsets: `along` is the way of a line.
PatternVariance of_lines(std::span<const float> picture, std::span<const float> noise,
                         const std::vector<bool>& bad, const PatternGrid& g, bool rows,
                         double pixel_variance) {
  PatternVariance out;
  const int lines = rows ? g.height_px : g.width_px, length = rows ? g.width_px : g.height_px;
  double square = 0, expected = 0, number = 0;
  // A line of a mosaic has two colours: each is a line of its own.
  for (int colour = 0; colour < g.stride; ++colour) {
    std::vector<double> mean(static_cast<std::size_t>(lines), 0.0), own(mean);
    for (int l = 0; l < lines; ++l) {
      double sum = 0, variance = 0, n = 0;
      for (int i = colour; i < length; i += g.stride) {
        const auto k = static_cast<std::size_t>(rows ? l * g.width_px + i : i * g.width_px + l);
        if (bad[k] || !std::isfinite(picture[k])) continue;
        sum += picture[k], variance += noise[k] + pixel_variance;
        ++n;
      }
      const auto at = static_cast<std::size_t>(l);
      mean[at] = n > 7 ? sum / n : std::nan("");
      own[at] = n > 7 ? variance / (n * n) : 0;
    }
    for (int l = 2 * g.stride; l < lines - 2 * g.stride; ++l) {
      double smooth = 0;
      for (int i = 0; i < 5; ++i)
        smooth += kSmooth[i] * mean[static_cast<std::size_t>(l + (i - 2) * g.stride)];
      const double e = mean[static_cast<std::size_t>(l)] - smooth;
      if (!std::isfinite(e)) continue;
      square += e * e / kKept;
      expected += own[static_cast<std::size_t>(l)];
      ++number;
    }
  }
  if (number < 8) return out;
  static const double kCorrelation = correlation();
  out.pixels = number;
  out.value = (square - expected) / number;
  out.sigma = square / number * std::sqrt(2 * kCorrelation / number);
  out.valid = true;
  return out;
}

}  // namespace

PatternSplit split_pattern(std::span<const float> picture, std::span<const float> noise,
                           const std::vector<bool>& bad, const PatternGrid& grid) {
  PatternSplit out;
  // Pixels: second differences along and across, in which lines cancel: p − its neighbours in row and column
  // + the fourth of the square, of variance 4 σ².
  const int s = grid.stride, w = grid.width_px;
  double square = 0, temporal = 0, number = 0;
  for (int y = 0; y + s < grid.height_px; ++y)
    for (int x = 0; x + s < w; ++x) {
      const auto a = static_cast<std::size_t>(y * w + x), b = a + static_cast<std::size_t>(s),
                 c = a + static_cast<std::size_t>(s * w), d = c + static_cast<std::size_t>(s);
      if (bad[a] || bad[b] || bad[c] || bad[d]) continue;
      const double e = double(picture[a]) - picture[b] - picture[c] + picture[d];
      if (!std::isfinite(e)) continue;
      square += e * e / 4;
      temporal += (double(noise[a]) + noise[b] + noise[c] + noise[d]) / 4;
      ++number;
    }
  if (number < 100) return out;
  out.pixel.pixels = number;
  out.pixel.value = (square - temporal) / number;
  // Autocorrelation of the filter: 1, ½ beside, ¼ across.
  out.pixel.sigma = square / number * std::sqrt(2 * (1 + 4 * 0.25 + 4 * 0.0625) / number);
  out.pixel.valid = true;
  const double pixel = std::max(0.0, out.pixel.value);
  out.row = of_lines(picture, noise, bad, grid, true, pixel);
  out.column = of_lines(picture, noise, bad, grid, false, pixel);
  return out;
}

}  // namespace rigor::calibration
