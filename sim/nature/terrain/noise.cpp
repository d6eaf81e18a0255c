#include "sim/nature/terrain/noise.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "sensor-hal/models/wide.h"

namespace rigor::nature {
namespace {

constexpr std::uint64_t kSeed = 0x7465727261696EULL;
// A lattice value is uniform in ±√3, variance 1; smoothstep interpolation between lattice points leaves
// (∫(s² + (1 − s)²))² = (26/35)² of the variance on average.
constexpr double kInterpolatedVariance = (26.0 / 35.0) * (26.0 / 35.0);

double smooth(double t) { return t * t * (3 - 2 * t); }

double lattice_value(std::uint32_t word) { return (unit_from_word(word) - 0.5) * 3.4641016151377544; }

double lattice(const FractalNoise& noise, int octave, std::int64_t i, std::int64_t j) {
  const auto w = place_words(kSeed, noise.stream, i, j, static_cast<std::uint32_t>(octave + 64));
  return lattice_value(w[0]);
}

/// lattice() at n points of row j, from column i0 on.
RIGOR_WIDE void lattice_row(std::uint32_t stream, std::uint32_t octave, std::int64_t i0, std::int64_t j,
                            std::size_t n, double* out) {
  constexpr std::size_t kBeside = 16;
  for (std::size_t first = 0; first < n; first += kBeside) {
    // place_words(), for places beside each other.
    std::uint32_t c0[kBeside], c1[kBeside], c2[kBeside], c3[kBeside];
    for (std::size_t k = 0; k < kBeside; ++k) {
      const std::int64_t x = i0 + static_cast<std::int64_t>(first + k);
      c0[k] = static_cast<std::uint32_t>(x);
      c1[k] = static_cast<std::uint32_t>(j);
      c2[k] = octave;
      c3[k] = place_high_word(x, j) ^ stream;
    }
    models::PhiloxKey key = place_key(kSeed, stream);
    for (int round = 0; round < 10; ++round) {
      for (std::size_t k = 0; k < kBeside; ++k) {
        const std::uint64_t p0 = std::uint64_t{c0[k]} * 0xD2511F53U, p1 = std::uint64_t{c2[k]} * 0xCD9E8D57U;
        c0[k] = static_cast<std::uint32_t>(p1 >> 32) ^ c1[k] ^ key.word0;
        c1[k] = static_cast<std::uint32_t>(p1);
        c2[k] = static_cast<std::uint32_t>(p0 >> 32) ^ c3[k] ^ key.word1;
        c3[k] = static_cast<std::uint32_t>(p0);
      }
      key.word0 += 0x9E3779B9U;
      key.word1 += 0xBB67AE85U;
    }
    const std::size_t here = std::min(kBeside, n - first);
    for (std::size_t k = 0; k < here; ++k) out[first + k] = lattice_value(c0[k]);
  }
}

RIGOR_WIDE void add_between(const double* low, const double* high, double t, double amplitude, int n,
                            float* sum) {
  for (int i = 0; i < n; ++i) sum[i] += static_cast<float>(amplitude * (low[i] * (1 - t) + high[i] * t));
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
  std::vector<double> points, rows[2], s(n);
  for (auto& row : rows) row.resize(n);
  std::vector<int> column(n);
  for (int k = noise.longest; k >= noise.shortest; --k, amplitude *= noise.gain) {
    if (std::ldexp(1.0, k) < 2 * places.step) {
      missing += amplitude * amplitude * kInterpolatedVariance;
      continue;
    }
    const double u0 = std::ldexp(places.x0, -k), v0 = std::ldexp(places.y0, -k),
                 step = std::ldexp(places.step, -k);
    const auto i0 = static_cast<std::int64_t>(std::floor(u0));
    const auto i1 = static_cast<std::int64_t>(std::floor(u0 + step * (n - 1)));
    points.resize(static_cast<std::size_t>(i1 - i0 + 2));
    for (int i = 0; i < n; ++i) {
      const double u = u0 + step * i, f = std::floor(u);
      column[i] = static_cast<int>(static_cast<std::int64_t>(f) - i0);
      s[i] = smooth(u - f);
    }
    // Of the two rows of lattice points around a row of places, between columns. Going south, the lower one
    // of the rows before becomes the higher one.
    const auto between = [&](std::int64_t j, std::vector<double>& row) {
      lattice_row(noise.stream, static_cast<std::uint32_t>(k + 64), i0, j, points.size(), points.data());
      for (int i = 0; i < n; ++i) {
        const double* a = &points[static_cast<std::size_t>(column[i])];
        row[i] = a[0] + (a[1] - a[0]) * s[i];
      }
    };
    std::int64_t at = 0;  // rows[0] is lattice row `at`, rows[1] the one north of it
    for (int j = 0; j < n; ++j) {
      const double v = v0 - step * j, f = std::floor(v), t = smooth(v - f);
      const auto south = static_cast<std::int64_t>(f);
      if (j == 0 || south != at) {
        if (j > 0 && south == at - 1)
          std::swap(rows[0], rows[1]);
        else
          between(south + 1, rows[1]);
        between(south, rows[0]);
        at = south;
      }
      add_between(rows[0].data(), rows[1].data(), t, amplitude, n,
                  &out.values[static_cast<std::size_t>(j) * n]);
    }
  }
  out.missing_sigma = std::sqrt(missing);
  return out;
}

}  // namespace rigor::nature
