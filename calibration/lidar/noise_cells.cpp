#include "calibration/lidar/noise_cells.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <numeric>

namespace rigor::calibration::lidar {
namespace {

constexpr double kOutlier = 4.5;            ///< a shot beyond this many sigmas is not noise
constexpr double kOneInTenThousand = 3.72;  ///< quantile of the normal distribution
constexpr std::size_t kSeries = 20;         ///< shots that make a series over time

/// Quantile of χ²/dof (Wilson & Hilferty 1931); z of the normal distribution.
double chi_square_quantile(double dof, double z) {
  const double a = 2 / (9 * dof), t = 1 - a + z * std::sqrt(a);
  return t > 0 ? t * t * t : 0;
}

/// Reorders `v`, which is not empty.
double median_of(std::vector<double>& v) {
  const auto middle = v.begin() + static_cast<std::ptrdiff_t>(v.size() / 2);
  std::nth_element(v.begin(), middle, v.end());
  return *middle;
}

/// Middle of the shortest interval that holds `share` of the values: the mode, wherever the others lie.
/// Reorders `v`, which is not empty.
double mode(std::vector<double>& v, double share) {
  std::sort(v.begin(), v.end());
  const auto n = static_cast<std::size_t>(std::ceil(share * static_cast<double>(v.size())));
  const std::size_t reach = std::clamp<std::size_t>(n, std::min<std::size_t>(3, v.size()), v.size()) - 1;
  double shortest = std::numeric_limits<double>::infinity();
  for (std::size_t i = 0; i + reach < v.size(); ++i) shortest = std::min(shortest, v[i + reach] - v[i]);
  // Rounded values make ties: their mean.
  double sum = 0, count = 0;
  for (std::size_t i = 0; i + reach < v.size(); ++i)
    if (v[i + reach] - v[i] <= 1.001 * shortest) sum += 0.5 * (v[i] + v[i + reach]), count += 1;
  return sum / count;
}

/// Median of sizes that are whole multiples of `step` (0: not rounded), as that of what was rounded.
double median_size(std::vector<double>& v, double step) {
  const double m = median_of(v);
  if (!(step > 0)) return m;
  double below = 0, equal = 0;
  for (const double x : v) below += x < m - 0.5 * step, equal += std::abs(x - m) <= 0.5 * step;
  const double share = (0.5 * static_cast<double>(v.size()) - below) / equal;
  return m < 0.5 * step ? 0.5 * step * share : m + step * (share - 0.5);
}

}  // namespace

NoiseCells::NoiseCells(const LidarReturns& returns, const models::LidarModel& sensor_model)
    : r_(returns), sensor_model_(sensor_model), step_m_(sensor_model.range.step_m) {
  group();
  for (Group& g : groups) measure(g, 0, false);
  std::erase_if(groups, [](const Group& g) { return g.cell.dof < 1; });
}

void NoiseCells::group() {
  // As narrow as a column of the scan where there are scans enough, else as wide as a dozen shots need.
  const double column =
      std::max(1e-4, std::abs(sensor_model_.scan.rotation_radps) * sensor_model_.scan.column_period_s);
  // Beyond a few degrees a parabola is not what a wall looks like.
  constexpr double kWidest = 2.5 * std::numbers::pi / 180;
  width_ = column * std::clamp(std::floor(kWidest / column), 1.0, std::ceil(12.0 / std::max(1u, r_.scans)));
  order.resize(r_.all.size());
  std::vector<std::uint64_t> key(r_.all.size());
  for (std::uint32_t i = 0; i < order.size(); ++i) {
    order[i] = i;
    const LidarReturn& x = r_.all[i];
    // Columns lie at whole multiples: cells are centred on them.
    const auto cell = static_cast<std::uint64_t>(
        std::floor((static_cast<double>(x.azimuth_rad) - sensor_model_.scan.start_azimuth_rad) / width_ +
                   0.5) +
        (1 << 24));
    key[i] = static_cast<std::uint64_t>(x.beam) << 32 | cell;
  }
  std::sort(order.begin(), order.end(),
            [&](std::uint32_t a, std::uint32_t b) { return key[a] != key[b] ? key[a] < key[b] : a < b; });
  for (std::uint32_t i = 0; i < order.size();) {
    std::uint32_t j = i;
    while (j < order.size() && key[order[j]] == key[order[i]]) ++j;
    if (j - i >= 4) groups.push_back({i, j, 0, {}});
    i = j;
  }
  shot_residual_m.assign(r_.all.size(), std::numeric_limits<float>::quiet_NaN());
}

void NoiseCells::measure(Group& g, double limit_m, bool keep) {
  const std::size_t n = g.end - g.begin;
  double a0 = 0, low = 1e9, high = -1e9;
  for (std::uint32_t k = g.begin; k < g.end; ++k) {
    const double a = r_.all[order[k]].azimuth_rad;
    a0 += a / static_cast<double>(n), low = std::min(low, a), high = std::max(high, a);
  }
  g.degree = high - low < 2e-5 ? 0 : width_ < 0.01 ? 1 : 2;
  std::vector<char> in(n, 1);
  g.cell = {};
  std::vector<double> e(n, 0), size(n, 0), t(n, 0), v(n, 0);
  const double reference = r_.all[order[g.begin]].range_m, half = std::max(1e-9, 0.5 * (high - low));
  for (std::size_t i = 0; i < n; ++i) {
    const LidarReturn& x = r_.all[order[g.begin + i]];
    t[i] = (static_cast<double>(x.azimuth_rad) - a0) / half;
    v[i] = static_cast<double>(x.range_m) - reference;
  }
  const int m = g.degree + 1;
  const auto fit = [&](const auto& weight) {
    Eigen::Matrix3d h = Eigen::Matrix3d::Identity();
    Eigen::Vector3d b = Eigen::Vector3d::Zero();
    h.topLeftCorner(m, m).setZero();
    for (std::size_t i = 0; i < n; ++i) {
      const double w = weight(i);
      const Eigen::Vector3d p(1, m > 1 ? t[i] : 0, m > 2 ? t[i] * t[i] : 0);
      h += w * p * p.transpose(), b += w * v[i] * p;
    }
    for (int k = m; k < 3; ++k) h(k, k) = 1;
    const Eigen::Vector3d c = h.ldlt().solve(b);
    for (std::size_t i = 0; i < n; ++i) e[i] = v[i] - c[0] - c[1] * t[i] - c[2] * t[i] * t[i];
  };
  const auto typical = [&] {
    for (std::size_t i = 0; i < n; ++i) size[i] = std::abs(e[i]);
    return median_of(size);
  };
  // Of a beam that stands still the mode; else least absolute residuals from the median: a third of the shots
  // may lie anywhere.
  size = v;
  const double centre = g.degree == 0 && n >= kSeries ? mode(size, 0.3) : median_of(size);
  for (std::size_t i = 0; i < n; ++i) e[i] = v[i] - centre;
  if (g.degree > 0)
    for (int round = 0; round < 6; ++round) {
      const double s = std::max(typical(), 1e-9 * std::abs(reference));
      fit([&](std::size_t i) { return 1 / (s + std::abs(e[i])); });
    }
  if (limit_m == 0) {
    const double s = 1.4826 * typical(),
                 share = static_cast<double>(n) / static_cast<double>(n - static_cast<std::size_t>(m));
    g.cell.variance_m2 = s * s * share;
    g.cell.dof = static_cast<double>(n) - m;
    if (n >= kSeries && g.degree == 0) {
      // |x − y| of two normal values has the median 0.6745·√2·σ.
      size.resize(n - 1);
      for (std::size_t i = 0; i + 1 < n; ++i) size[i] = std::abs(v[i + 1] - v[i]);
      const double of_differences = median_size(size, step_m_) / 0.9538726;
      g.cell.variance_m2 = std::min(g.cell.variance_m2, of_differences * of_differences);
    }
  } else {
    double used = 0, sum = 0;
    for (int round = 0; round < 3; ++round) {
      used = sum = 0;
      for (std::size_t i = 0; i < n; ++i) in[i] = std::abs(e[i]) <= limit_m;
      for (std::size_t i = 0, run = 0; i < n; ++i) {
        run = std::abs(e[i]) <= limit_m ? 0 : run + 1;
        if (run < 3 || n < kSeries) continue;
        if (i >= run) in[i - run] = 0;
        if (i + 1 < n) in[i + 1] = 0;
      }
      for (std::size_t i = 0; i < n; ++i) used += in[i];
      // A third of a series, or there is no surface to speak of.
      if (used < m + 1 || (n >= kSeries && used < 0.3 * static_cast<double>(n))) {
        g.cell.dof = 0;
        return;
      }
      fit([&](std::size_t i) { return in[i] ? 1.0 : 0.0; });
    }
    double products = 0;
    g.pairs = 0;
    for (std::size_t i = 0; i < n; ++i) {
      if (!in[i]) continue;
      sum += e[i] * e[i];
      if (i > 0 && in[i - 1]) products += e[i] * e[i - 1], g.pairs += 1;
    }
    g.cell.variance_m2 = sum / (used - m);
    g.cell.dof = used - m;
    g.correlation = sum > 0 && g.pairs > 0 ? products / g.pairs / (sum / used) : 0;
  }
  double used = 0, units = 0, units_square = 0, range = 0;
  for (std::size_t i = 0; i < n; ++i) {
    if (!in[i]) continue;
    const LidarReturn& x = r_.all[order[g.begin + i]];
    ++used;
    const double u = std::isfinite(x.remission) ? static_cast<double>(x.remission) : 0;
    units += u, units_square += u * u;
    range += static_cast<double>(x.range_m);
  }
  g.cell.units = units / used, g.cell.range_m = range / used;
  g.cell.units_variance = std::max(0.0, units_square - units * units / used) / (used - 1);
  g.cell.remission = remission_from_units(sensor_model_.remission, g.cell.units, g.cell.range_m);
  if (!keep) return;
  for (std::size_t i = 0; i < n; ++i)
    if (in[i]) shot_residual_m[order[g.begin + i]] = static_cast<float>(e[i]);
}

std::vector<double> NoiseCells::typical_variance() const {
  std::vector<std::size_t> by(groups.size());
  std::iota(by.begin(), by.end(), std::size_t{0});
  std::stable_sort(by.begin(), by.end(), [&](std::size_t a, std::size_t b) {
    return groups[a].cell.remission < groups[b].cell.remission;
  });
  const double least = std::max(step_m_ * step_m_ / 100, std::numeric_limits<double>::min());
  const std::size_t bins = std::clamp<std::size_t>(groups.size() / 40, 1, 40);
  const auto first_of = [&](std::size_t k) { return k * by.size() / bins; };
  std::vector<double> log_of(bins, std::numeric_limits<double>::quiet_NaN());
  for (std::size_t k = 0; k < bins; ++k) {
    std::vector<double> logs, dofs;
    for (std::size_t i = first_of(k); i < first_of(k + 1); ++i) {
      const Group& g = groups[by[i]];
      if (g.cell.dof < 1 || g.moved) continue;
      logs.push_back(std::log(std::max(least, g.cell.variance_m2 / chi_square_quantile(g.cell.dof, 0))));
      dofs.push_back(g.cell.dof);
    }
    if (logs.empty()) continue;
    std::vector<double> copy = logs, copy_of_dofs = dofs;
    // Few shots scatter a cell's variance so far that a mode says less than the median.
    if (median_of(copy_of_dofs) < kSeries) {
      log_of[k] = median_of(copy);
      continue;
    }
    log_of[k] = mode(copy, 0.3);
    for (int round = 0; round < 3; ++round) {
      copy.clear();
      for (std::size_t i = 0; i < logs.size(); ++i)
        if (logs[i] <= log_of[k] + std::log(chi_square_quantile(dofs[i], kOneInTenThousand)))
          copy.push_back(logs[i]);
      log_of[k] = median_of(copy);
    }
  }
  // Noise changes steadily with remission: a running median over half of the bins follows it, and not a bin
  // in which most of the cells move. At the ends, where it lags, it says less.
  std::vector<double> typical(groups.size(), 0), window;
  const std::size_t reach = std::max<std::size_t>(1, bins / 4);
  for (std::size_t k = 0; k < bins; ++k) {
    double log_typical = log_of[k];
    window.clear();
    const bool inside = k >= reach && k + reach < bins;
    for (std::size_t j = k >= reach ? k - reach : 0; j < bins && j <= k + reach; ++j)
      if (std::isfinite(log_of[j])) window.push_back(log_of[j]);
    const bool plain = groups[by[first_of(k)]].cell.remission <= 1;
    if (bins >= 5 && !window.empty() && (plain || inside || !std::isfinite(log_typical))) {
      const double most = median_of(window) + std::log(inside ? 1.5 : 4.0);
      log_typical = std::isfinite(log_typical) ? std::min(log_typical, most) : most;
    }
    for (std::size_t i = first_of(k); i < first_of(k + 1); ++i)
      typical[by[i]] = std::isfinite(log_typical) ? std::exp(log_typical) : 0;
  }
  return typical;
}

void NoiseCells::choose() {
  std::vector<double> typical = typical_variance();
  for (std::size_t i = 0; i < groups.size(); ++i)
    measure(groups[i], kOutlier * std::sqrt(typical[i]) + step_m_, false);
  // All noise of a device may hang together from scan to scan, by a little; of a thing that moves it does.
  std::vector<double> correlations;
  for (const Group& g : groups)
    if (g.cell.dof >= 1 && g.pairs >= kSeries) correlations.push_back(g.correlation);
  const double common = correlations.empty() ? 0 : std::max(0.0, median_of(correlations));
  for (Group& g : groups)
    g.moved = g.pairs >= kSeries && (g.correlation - common) * std::sqrt(g.pairs) > kOneInTenThousand;
  typical = typical_variance();
  for (std::size_t i = 0; i < groups.size(); ++i) {
    Group& g = groups[i];
    // One good cell in ten thousand goes with the bad.
    g.cell.used = g.cell.dof >= 1 && !g.moved &&
                  g.cell.variance_m2 <= typical[i] * chi_square_quantile(g.cell.dof, kOneInTenThousand);
    if (!g.cell.used) continue;
    measure(g, kOutlier * std::sqrt(typical[i]) + step_m_, true);
    g.cell.used = g.cell.dof >= 1;
  }
}

}  // namespace rigor::calibration::lidar
