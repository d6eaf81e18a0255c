#include "sim/sensors/camera/sensor_stage_bloom.h"
#include "sim/sensors/camera/rows.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <numbers>

#include "sensor-hal/models/one_source.h"
#include "sensor-hal/models/wide.h"

namespace rigor::sensor_stage {
namespace {

using Model = models::PictureMath<double>;

/// A Gaussian is convolved at the level where its standard deviation is this to twice this many pixels.
constexpr double kSigma_px = 1.25;
constexpr double kReach_sigma = 3.5;  ///< taps go that far: beyond it the next Gaussian is wider and stronger
constexpr double kRankTolerance = 2e-4;  ///< of the core's light that its separable parts may miss

// out[x] (+)= sum over k of taps[k] (in[x - k] + in[x + k]); `in` is readable `n` taps beyond both ends.
RIGOR_WIDE void filter_row(const float* __restrict in, const float* __restrict taps, int n, int count,
                           float* __restrict out) {
  for (int x = 0; x < count; ++x) out[x] = taps[0] * in[x];
  for (int k = 1; k < n; ++k) {
    const float w = taps[k];
    const float* const left = in - k;
    const float* const right = in + k;
    for (int x = 0; x < count; ++x) out[x] += w * (left[x] + right[x]);
  }
}

RIGOR_WIDE void add_scaled(const float* __restrict a, const float* __restrict b, float w, int count,
                           float* __restrict out) {
  for (int x = 0; x < count; ++x) out[x] += w * (a[x] + b[x]);
}

RIGOR_WIDE void combine_rows(const float* __restrict a, const float* __restrict b, const float* __restrict c,
                             const float* __restrict d, int count, float* __restrict out) {
  for (int x = 0; x < count; ++x) out[x] = 0.75f * (b[x] + c[x]) + 0.25f * (a[x] + d[x]);
}

RIGOR_WIDE void multiply(const float* __restrict a, const float* __restrict b, int count,
                         float* __restrict out) {
  for (int x = 0; x < count; ++x) out[x] = a[x] * b[x];
}

RIGOR_WIDE void mix(const float* __restrict balance, const float* __restrict spread, float fraction,
                    float veiling_glare, float mean, int count, float* __restrict plane) {
  using M = models::PictureMath<float>;
  for (int x = 0; x < count; ++x)
    plane[x] = M::bloom_mix(plane[x], balance[x] * spread[x], mean, fraction, veiling_glare);
}

/// In an order of its own, the same on any number of threads.
double sum_of(const std::vector<float>& plane, int width, int height) {
  std::vector<double> rows(static_cast<std::size_t>(height));
  for_rows(height, [&](int y) {
    const float* const row = plane.data() + static_cast<std::size_t>(y) * width;
    double part[4] = {};
    int x = 0;
    for (; x + 4 <= width; x += 4)
      for (int k = 0; k < 4; ++k) part[k] += row[x + k];
    for (; x < width; ++x) part[0] += row[x];
    rows[static_cast<std::size_t>(y)] = (part[0] + part[1]) + (part[2] + part[3]);
  });
  double sum = 0;
  for (const double r : rows) sum += r;
  return sum;
}

/// Half the size and a cell more on each side, for the light that the border's pixels put there.
int half_of(int size) { return size / 2 + 2; }

}  // namespace

BloomOperator::BloomOperator(int width_px, int height_px, const Bloom& bloom)
    : width_(width_px), height_(height_px), bloom_(bloom) {
  levels_.push_back({width_, height_, {}, {}, {}});
  if (bloom_.fraction <= 0) return;
  struct Gaussian {
    double sigma_px, height;
  };
  std::vector<Gaussian> gaussians;
  const double step = std::log(2.0), diagonal_px = std::hypot(width_, height_);
  double constant = 0;
  for (double t = 64.0;; t *= 0.5) {
    const double sigma = Model::bloom_gaussian_sigma(t, bloom_.radius_px);
    const double height = Model::bloom_gaussian_height(t, bloom_.exponent, step);
    if (sigma > 4.0 * diagonal_px) {
      // The rest of a geometric series, in a picture much smaller than they are wide.
      constant = height / (1.0 - std::exp2(-bloom_.exponent));
      break;
    }
    gaussians.push_back({sigma, height});
  }
  // By light, not by height: a narrow Gaussian counts for little.
  double most = 0;
  for (const Gaussian& g : gaussians) most = std::max(most, g.height * (0.5 + g.sigma_px * g.sigma_px));
  std::vector<std::vector<Gaussian>> at_level;
  for (const Gaussian& g : gaussians) {
    if (g.height * (0.5 + g.sigma_px * g.sigma_px) < 1e-6 * most) continue;
    const auto level = static_cast<std::size_t>(std::max(0.0, std::floor(std::log2(g.sigma_px / kSigma_px))));
    if (at_level.size() <= level) at_level.resize(level + 1);
    at_level[level].push_back(g);
  }
  if (at_level.empty()) at_level.resize(1);
  while (levels_.size() < at_level.size())
    levels_.push_back({half_of(levels_.back().width), half_of(levels_.back().height), {}, {}, {}});
  std::size_t largest = 0;  // the second level of a picture of few pixels is larger than the first
  for (Level& l : levels_) {
    largest = std::max(largest, static_cast<std::size_t>(l.width) * l.height);
    l.light.assign(static_cast<std::size_t>(l.width) * l.height, 0.0f);
    l.spread.assign(static_cast<std::size_t>(l.width) * l.height, 0.0f);
  }
  scratch_.assign(largest, 0.0f);

  // The core, as a sum of few separable filters: the eigenvectors of its samples.
  if (!at_level[0].empty()) {
    double widest = 0;
    for (const Gaussian& g : at_level[0]) widest = std::max(widest, g.sigma_px);
    const int reach = std::max(1, static_cast<int>(std::ceil(kReach_sigma * widest)));
    Eigen::MatrixXd core(2 * reach + 1, 2 * reach + 1);
    for (int i = -reach; i <= reach; ++i)
      for (int k = -reach; k <= reach; ++k) {
        double v = 0;
        for (const Gaussian& g : at_level[0])
          v += g.height * std::exp(-0.5 * (i * i + k * k) / (g.sigma_px * g.sigma_px));
        core(i + reach, k + reach) = v;
      }
    const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> parts(core);
    double left = core.sum();
    const double tolerance = kRankTolerance * left;
    for (Eigen::Index i = core.rows() - 1; i >= 0 && left > tolerance; --i) {
      const Eigen::VectorXd v = parts.eigenvectors().col(i);
      const double light = parts.eigenvalues()(i) * v.sum() * v.sum();
      if (std::abs(light) < 0.1 * tolerance) continue;  // odd parts: none by symmetry
      left -= light;
      Filter f;
      for (int k = 0; k <= reach; ++k) {
        // Mean of both sides: symmetric to the last bit.
        const double tap = 0.5 * (v(reach + k) + v(reach - k));
        f.column.push_back(static_cast<float>(tap));
        f.row.push_back(static_cast<float>(tap * parts.eigenvalues()(i)));
      }
      levels_[0].filters.push_back(std::move(f));
    }
  }
  for (std::size_t level = 1; level < at_level.size(); ++level)
    for (const Gaussian& g : at_level[level]) {
      const double scale = std::exp2(static_cast<double>(level));
      // The way down and up widens by itself: each step by 0.75 px^2 of the finer picture, both ways.
      const double own = 0.5 * (1.0 - 1.0 / (scale * scale));
      const double sigma = std::sqrt(g.sigma_px * g.sigma_px / (scale * scale) - own);
      const int reach = static_cast<int>(std::ceil(kReach_sigma * sigma));
      std::vector<double> taps;
      double sum = 0;
      for (int k = 0; k <= reach; ++k) {
        taps.push_back(std::exp(-0.5 * k * k / (sigma * sigma)));
        sum += taps.back() * (k == 0 ? 1.0 : 2.0);
      }
      const double light = g.height * 2.0 * std::numbers::pi * g.sigma_px * g.sigma_px;
      Filter f;
      for (const double tap : taps) {
        f.column.push_back(static_cast<float>(tap / sum));
        f.row.push_back(static_cast<float>(tap / sum * light));
      }
      levels_[level].filters.push_back(std::move(f));
    }
  constant_ = static_cast<float>(constant);

  // d with d (K d) = 1. The step d / sqrt(d K d) halves the error at least, for K has no negative eigenvalue
  // of weight.
  const std::size_t n = static_cast<std::size_t>(width_) * height_;
  balance_.assign(n, 1.0f);
  for (int round = 0; round < 60; ++round) {
    levels_[0].light = balance_;
    spread();
    float worst = 0;
    for (std::size_t i = 0; i < n; ++i) {
      const float light = balance_[i] * levels_[0].spread[i];
      worst = std::max(worst, std::abs(light - 1.0f));
      balance_[i] /= std::sqrt(light);
    }
    if (worst < 4e-7f) break;
  }
}

void BloomOperator::spread() {
  const float even_light =
      constant_ > 0 ? static_cast<float>(constant_ * sum_of(levels_[0].light, width_, height_)) : 0.0f;
  // Down: each cell gives 3/4 of its light to the cell over it and 1/4 to the next, along both axes.
  for (std::size_t l = 0; l + 1 < levels_.size(); ++l) {
    const Level& fine = levels_[l];
    Level& coarse = levels_[l + 1];
    const std::vector<float> nothing(static_cast<std::size_t>(fine.width), 0.0f);
    const auto row = [&](int y) {
      return y < 0 || y >= fine.height ? nothing.data()
                                       : fine.light.data() + static_cast<std::size_t>(y) * fine.width;
    };
    for_rows(coarse.height, [&](int y) {
      // Cell i lies over the pixels 2i - 2 and 2i - 1; it takes from 2i - 3 to 2i.
      thread_local std::vector<float> sums;
      sums.assign(static_cast<std::size_t>(2 * coarse.width) + 4, 0.0f);
      float* const s = sums.data() + 3;
      combine_rows(row(2 * y - 3), row(2 * y - 2), row(2 * y - 1), row(2 * y), fine.width, s);
      float* const out = coarse.light.data() + static_cast<std::size_t>(y) * coarse.width;
      for (int x = 0; x < coarse.width; ++x)
        out[x] = 0.75f * (s[2 * x - 2] + s[2 * x - 1]) + 0.25f * (s[2 * x - 3] + s[2 * x]);
    });
  }
  // At each level its Gaussians, from the coarsest up; what the coarser ones gave is spread on.
  for (std::size_t l = levels_.size(); l-- > 0;) {
    Level& level = levels_[l];
    const Level* const coarse = l + 1 < levels_.size() ? &levels_[l + 1] : nullptr;
    for_rows(level.height, [&](int y) {
      float* const out = level.spread.data() + static_cast<std::size_t>(y) * level.width;
      if (coarse == nullptr) {
        std::fill(out, out + level.width, l == 0 ? even_light : 0.0f);
        return;
      }
      const int i = y / 2, near = i + 1, far = y % 2 == 0 ? i : i + 2;
      const float* const a = coarse->spread.data() + static_cast<std::size_t>(near) * coarse->width;
      const float* const b = coarse->spread.data() + static_cast<std::size_t>(far) * coarse->width;
      // The transposed weights, over 2 along each axis for the cells' size.
      const auto cell = [&](int x) { return 0.375f * a[x] + 0.125f * b[x]; };
      const float base = l == 0 ? even_light : 0.0f;
      for (int x = 0; x < level.width; ++x) {
        const int c = x / 2;
        out[x] = 0.375f * cell(c + 1) + 0.125f * cell(x % 2 == 0 ? c : c + 2) + base;
      }
    });
    for (const Filter& f : level.filters) {
      const int reach_x = static_cast<int>(f.row.size()) - 1, reach_y = static_cast<int>(f.column.size()) - 1;
      for_rows(level.height, [&](int y) {
        thread_local std::vector<float> padded;
        padded.assign(static_cast<std::size_t>(level.width + 2 * reach_x), 0.0f);
        const float* const in = level.light.data() + static_cast<std::size_t>(y) * level.width;
        std::copy(in, in + level.width, padded.data() + reach_x);
        filter_row(padded.data() + reach_x, f.row.data(), reach_x + 1, level.width,
                   scratch_.data() + static_cast<std::size_t>(y) * level.width);
      });
      const std::vector<float> nothing(static_cast<std::size_t>(level.width), 0.0f);
      for_rows(level.height, [&](int y) {
        const auto row = [&](int v) {
          return v < 0 || v >= level.height ? nothing.data()
                                            : scratch_.data() + static_cast<std::size_t>(v) * level.width;
        };
        float* const out = level.spread.data() + static_cast<std::size_t>(y) * level.width;
        add_scaled(row(y), nothing.data(), f.column[0], level.width, out);
        for (int k = 1; k <= reach_y; ++k)
          if (y - k >= 0 || y + k < level.height)
            add_scaled(row(y - k), row(y + k), f.column[static_cast<std::size_t>(k)], level.width, out);
      });
    }
  }
}

void BloomOperator::apply(std::vector<float>& plane) {
  const auto row_of = [this](std::vector<float>& v, int y) {
    return v.data() + static_cast<std::size_t>(y) * width_;
  };
  float mean = 0;
  if (bloom_.veiling_glare > 0)
    mean = static_cast<float>(sum_of(plane, width_, height_) / (static_cast<double>(width_) * height_));
  const auto fraction = static_cast<float>(bloom_.fraction), glare = static_cast<float>(bloom_.veiling_glare);
  if (bloom_.fraction > 0) {
    for_rows(height_, [&](int y) {
      multiply(row_of(balance_, y), row_of(plane, y), width_, row_of(levels_[0].light, y));
    });
    spread();
    for_rows(height_, [&](int y) {
      mix(row_of(balance_, y), row_of(levels_[0].spread, y), fraction, glare, mean, width_, row_of(plane, y));
    });
  } else {
    for_rows(height_, [&](int y) {
      float* const p = row_of(plane, y);
      for (int x = 0; x < width_; ++x)
        p[x] = models::PictureMath<float>::bloom_mix(p[x], 0.0f, mean, 0.0f, glare);
    });
  }
}

}  // namespace rigor::sensor_stage
