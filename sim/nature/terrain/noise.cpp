#include "sim/nature/terrain/noise.h"

#include <cmath>

namespace rigor::nature {
namespace {

constexpr std::uint64_t kSeed = 0x7465727261696EULL;
// A lattice value is uniform in ±√3, variance 1; smoothstep interpolation between lattice points leaves
// (∫(s² + (1 − s)²))² = (26/35)² of the variance on average.
constexpr double kInterpolatedVariance = (26.0 / 35.0) * (26.0 / 35.0);

double smooth(double t) { return t * t * (3 - 2 * t); }

double lattice(const FractalNoise& noise, int octave, std::int64_t i, std::int64_t j) {
  const auto w = place_words(kSeed, noise.stream, i, j, static_cast<std::uint32_t>(octave + 64));
  return (unit_from_word(w[0]) - 0.5) * 3.4641016151377544;
}

}  // namespace

double FractalNoise::sigma() const {
  double variance = 0, amplitude = 1;
  for (int k = longest; k >= shortest; --k, amplitude *= gain) variance += amplitude * amplitude;
  return std::sqrt(variance * kInterpolatedVariance);
}

double noise_at(const FractalNoise& noise, double x, double y) {
  double sum = 0, amplitude = 1;
  for (int k = noise.longest; k >= noise.shortest; --k, amplitude *= noise.gain) {
    const double u = std::ldexp(x, -k), v = std::ldexp(y, -k);
    const double fu = std::floor(u), fv = std::floor(v);
    const auto i = static_cast<std::int64_t>(fu), j = static_cast<std::int64_t>(fv);
    const double s = smooth(u - fu), t = smooth(v - fv);
    const double a = lattice(noise, k, i, j), b = lattice(noise, k, i + 1, j);
    const double c = lattice(noise, k, i, j + 1), d = lattice(noise, k, i + 1, j + 1);
    sum += amplitude * ((a + (b - a) * s) * (1 - t) + (c + (d - c) * s) * t);
  }
  return sum;
}

NoiseRaster noise_over(const FractalNoise& noise, const RasterPlaces& places) {
  NoiseRaster out;
  const int n = places.n;
  out.values.assign(static_cast<std::size_t>(n) * n, 0.0F);
  double amplitude = 1, missing = 0;
  std::vector<double> grid, s(n);
  std::vector<int> column(n);
  for (int k = noise.longest; k >= noise.shortest; --k, amplitude *= noise.gain) {
    if (std::ldexp(1.0, k) < 2 * places.step) {
      missing += amplitude * amplitude * kInterpolatedVariance;
      continue;
    }
    const double u0 = std::ldexp(places.x0, -k), v0 = std::ldexp(places.y0, -k),
                 step = std::ldexp(places.step, -k);
    const auto i0 = static_cast<std::int64_t>(std::floor(u0));
    const auto j1 = static_cast<std::int64_t>(std::floor(v0));
    const auto j0 = static_cast<std::int64_t>(std::floor(v0 - step * (n - 1)));
    const auto i1 = static_cast<std::int64_t>(std::floor(u0 + step * (n - 1)));
    const auto width = static_cast<std::size_t>(i1 - i0 + 2), height = static_cast<std::size_t>(j1 - j0 + 2);
    grid.resize(width * height);
    for (std::size_t j = 0; j < height; ++j) {
      for (std::size_t i = 0; i < width; ++i) {
        grid[j * width + i] =
            lattice(noise, k, i0 + static_cast<std::int64_t>(i), j0 + static_cast<std::int64_t>(j));
      }
    }
    for (int i = 0; i < n; ++i) {
      const double u = u0 + step * i, f = std::floor(u);
      column[i] = static_cast<int>(static_cast<std::int64_t>(f) - i0);
      s[i] = smooth(u - f);
    }
    for (int j = 0; j < n; ++j) {
      const double v = v0 - step * j, f = std::floor(v), t = smooth(v - f);
      const double* low = &grid[static_cast<std::size_t>(static_cast<std::int64_t>(f) - j0) * width];
      const double* high = low + width;
      float* row = &out.values[static_cast<std::size_t>(j) * n];
      for (int i = 0; i < n; ++i) {
        const double* a = low + column[i];
        const double* c = high + column[i];
        row[i] += static_cast<float>(
            amplitude * ((a[0] + (a[1] - a[0]) * s[i]) * (1 - t) + (c[0] + (c[1] - c[0]) * s[i]) * t));
      }
    }
  }
  out.missing_sigma = std::sqrt(missing);
  return out;
}

}  // namespace rigor::nature
