#include "calibration/pair/value_model.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "sensor-hal/channel/pair_watch/value_change.h"

namespace rigor::calibration {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr std::size_t kMostWindows = 32, kLeastInWindow = 16;

/// Cubic Hermite with slopes of the neighbours; NaN outside.
double at(const std::vector<double>& t, const std::vector<double>& x, double when) {
  const auto next = std::upper_bound(t.begin(), t.end(), when);
  const auto i = next - t.begin();
  if (i < 2 || i + 1 >= std::ptrdiff_t(t.size())) {
    // On a sample itself at the ends.
    return kInfinity - kInfinity;
  }
  const std::size_t b = std::size_t(i) - 1, c = std::size_t(i), a = b - 1, d = c + 1;
  const double h = t[c] - t[b], s = (when - t[b]) / h;
  const double mb = (x[c] - x[a]) / (t[c] - t[a]) * h, mc = (x[d] - x[b]) / (t[d] - t[b]) * h;
  const double s2 = s * s, s3 = s2 * s;
  return (2 * s3 - 3 * s2 + 1) * x[b] + (s3 - 2 * s2 + s) * mb + (3 * s2 - 2 * s3) * x[c] + (s3 - s2) * mc;
}

double second_difference_variance(const std::vector<double>& x) {
  double sum = 0, n = 0;
  for (std::size_t i = 0; i + 2 < x.size(); i += 3)
    if (const double d = x[i] - 2 * x[i + 1] + x[i + 2]; std::isfinite(d)) sum += d * d / 6, ++n;
  return n > 0 ? sum / n : 0;
}

}  // namespace

Result<ValueFit> fit_value_pair(const ValueSeries& series, int most_passes) {
  const std::size_t n = series.t_s.size();
  if (n < 4 * kLeastInWindow)
    return fail(ErrorCode::bad_input, series.name,
                "expected 64 instants of both sides or more, got " + std::to_string(n));
  for (std::size_t i = 1; i < n; ++i)
    if (!(series.t_s[i] > series.t_s[i - 1]))
      return fail(ErrorCode::bad_input, series.name, "expected times that increase");
  const std::size_t windows = std::clamp(n / kLeastInWindow, std::size_t{4}, kMostWindows);
  ValueFit fit;
  fit.name = series.name, fit.unit = series.unit;
  fit.windows = int(windows);
  auto change = pair_watch::ValueChange::make({{series.name, series.unit, 0}});
  if (!change) return tl::unexpected<Error>(change.error());
  const auto& t = series.t_s;
  std::vector<double> carried = series.simulated;
  std::vector<std::array<double, 3>> each;
  for (int pass = 0; pass < most_passes; ++pass) {
    ++fit.passes;
    fit.after = {};
    each.clear();
    for (std::size_t i = 0; i < n; ++i) {
      if (pass > 0)
        carried[i] =
            fit.bias + (1 + fit.scale) * (fit.delay_s == 0 ? series.simulated[i]
                                                           : at(t, series.simulated, t[i] - fit.delay_s));
      const double residual = series.real[i] - carried[i];
      if (std::isfinite(residual)) {
        if (pass == 0) fit.before.add(residual);
        fit.after.add(residual);
      }
    }
    for (std::size_t w = 0; w < windows; ++w) {
      for (std::size_t i = w * n / windows; i < (w + 1) * n / windows; ++i)
        (void)change->add(t[i], {&series.real[i], 1}, {&carried[i], 1});
      pair_watch::Estimate e;
      change->finish(e);
      if (std::isfinite(e.value[0])) each.push_back({e.value[0], e.value[1], e.value[2]});
    }
    // A window in which the number stands still says bias alone: then it has another meaning than beside a
    // scale. Where most windows move, those count alone.
    const auto moving =
        std::count_if(each.begin(), each.end(), [](const auto& w) { return std::isfinite(w[1]); });
    const bool moves = 2 * std::size_t(moving) > each.size();
    if (moves)
      std::erase_if(each, [](const auto& w) { return !std::isfinite(w[1]) || !std::isfinite(w[2]); });
    const double m = double(each.size());
    if (m < 4)
      return fail(ErrorCode::bad_input, series.name,
                  "expected numbers that both sides have in most of the recording, found too few");
    Eigen::Vector3d mean = Eigen::Vector3d::Zero();
    const std::size_t terms = moves ? 3 : 1;
    for (const auto& w : each)
      for (std::size_t k = 0; k < terms; ++k) mean[Eigen::Index(k)] += w[k] / m;
    fit.covariance.setZero();
    for (const auto& w : each)
      for (std::size_t k = 0; k < terms; ++k)
        for (std::size_t l = 0; l < terms; ++l)
          fit.covariance(Eigen::Index(k), Eigen::Index(l)) +=
              (w[k] - mean[Eigen::Index(k)]) * (w[l] - mean[Eigen::Index(l)]) / (m * (m - 1));
    const auto sigma = [&](Eigen::Index k) {
      return std::size_t(k) < terms ? std::sqrt(fit.covariance(k, k)) : kInfinity;
    };
    fit.bias_sigma = sigma(0), fit.scale_sigma = sigma(1), fit.delay_sigma_s = sigma(2);
    if (pass == 0) fit.one_step_delay_s = mean[2];
    bool small = true;
    for (Eigen::Index k = 0; k < Eigen::Index(terms); ++k)
      small = small && std::abs(mean[k]) <= 0.01 * sigma(k) + 1e-15;
    if (small) break;
    // Of (1 + s) x + b carried over, a scale s' and a bias b' more.
    fit.bias = (1 + mean[1]) * fit.bias + mean[0];
    fit.scale = (1 + fit.scale) * (1 + mean[1]) - 1;
    fit.delay_s += mean[2];
  }
  // The signal's own bend is in both sides alike; in their difference it is not: of the variances the sum,
  // and the difference.
  std::vector<double> apart(n);
  for (std::size_t i = 0; i < n; ++i) apart[i] = series.real[i] - series.simulated[i];
  const double sum = second_difference_variance(apart),
               more = second_difference_variance(series.real) - second_difference_variance(series.simulated);
  const double real = std::max(0.0, (sum + more) / 2), simulated = std::max(0.0, (sum - more) / 2);
  fit.noise_real = std::sqrt(real), fit.noise_simulated = std::sqrt(simulated);
  fit.noise_ratio = simulated > 0 ? std::sqrt(real / simulated) : real > 0 ? kInfinity : 0;
  // Each is a mean of n/3 independent squares of normal numbers.
  fit.noise_ratio_sigma =
      std::isfinite(fit.noise_ratio) ? fit.noise_ratio * std::sqrt(3.0 / double(n)) : kInfinity;
  return fit;
}

}  // namespace rigor::calibration
