#include "calibration/tof/local_noise.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>

#include "calibration/core/chi_squared.h"

namespace rigor::calibration {
namespace {

struct Window {
  double log_amplitude, inverse, inverse_square, variance_m2;
};

/// Takes a quadratic surface out of n x n values: their residuals.
Eigen::MatrixXd residual_projection(int n) {
  const int m = n * n;
  Eigen::MatrixXd b(m, 6);
  for (int i = 0; i < m; ++i) {
    const double x = i % n - n / 2, y = i / n - n / 2;
    b.row(i) << 1, x, y, x * x, x * y, y * y;
  }
  const Eigen::MatrixXd q = b.householderQr().householderQ() * Eigen::MatrixXd::Identity(m, 6);
  return Eigen::MatrixXd::Identity(m, m) - q * q.transpose();
}

double median_of(std::vector<double>& v) {
  const auto middle = v.begin() + static_cast<std::ptrdiff_t>(v.size() / 2);
  std::nth_element(v.begin(), middle, v.end());
  return *middle;
}

}  // namespace

double amplitude_ceiling(std::span<const TofFrame> frames) {
  float top = 0;
  for (const TofFrame& f : frames)
    for (const float a : f.amplitude)
      if (std::isfinite(a)) top = std::max(top, a);
  std::size_t at = 0, below = 0, all = 0;
  for (const TofFrame& f : frames)
    for (const float a : f.amplitude) {
      if (!(a > 0)) continue;
      ++all;
      at += a == top;
      below += a < top && a >= 0.98F * top;
    }
  const bool pile = at >= 10 && static_cast<double>(at) > 1e-3 * static_cast<double>(all) && at > below;
  return pile ? static_cast<double>(top) : std::numeric_limits<double>::infinity();
}

Result<LocalNoise> spatial_noise(std::span<const TofFrame> frames, const SpatialNoiseOptions& options) {
  const int n = options.window_px;
  if (n < 5 || n > 31 || n % 2 == 0)
    return fail(ErrorCode::bad_input, "--window",
                "expected an odd window of 5 to 31 px, got " + std::to_string(n));
  const double ceiling = amplitude_ceiling(frames);
  const Eigen::MatrixXd projection = residual_projection(n);
  const int m = n * n, dof = m - 6;
  LocalNoise out;
  std::vector<Window> windows;
  Eigen::VectorXd z(m);
  std::size_t seen = 0;
  bool amplitudes = false;
  for (const TofFrame& f : frames) {
    if (f.amplitude.size() != f.range_m.size()) continue;
    amplitudes = true;
    for (int v = 0; v + n <= f.height_px; v += n)
      for (int u = 0; u + n <= f.width_px; u += n) {
        double least = 1e300, most = 0, log_sum = 0, inverse = 0, square = 0;
        bool whole = true;
        for (int i = 0; i < m && whole; ++i) {
          const auto p = static_cast<std::size_t>((v + i / n) * f.width_px + u + i % n);
          const double a = f.amplitude[p], r = f.range_m[p];
          if (a >= ceiling) ++out.saturated;
          whole = std::isfinite(r) && r > 0 && a > 0 && a < ceiling;
          if (!whole) break;
          z[i] = r;
          least = std::min(least, a), most = std::max(most, a);
          log_sum += std::log(a), inverse += 1 / a, square += 1 / (a * a);
        }
        if (!whole) continue;
        if (most > options.max_amplitude_ratio * least) {
          ++out.edges;
          continue;
        }
        z.array() -= z.mean();
        const Eigen::VectorXd e = projection * z;
        windows.push_back({log_sum / m, inverse / m, square / m, e.squaredNorm() / dof});
        if (seen++ % 7 == 0 && out.samples.size() < 20000)
          for (int i = 0; i < m; i += 6)
            out.samples.push_back({std::exp(log_sum / m), e[i] / std::sqrt(projection(i, i))});
      }
  }
  out.windows = windows.size();
  if (windows.size() < options.minimum_windows)
    return fail(ErrorCode::bad_input, "noise against amplitude",
                (amplitudes ? "expected at least " + std::to_string(options.minimum_windows) +
                                  " windows of " + std::to_string(n) + "x" + std::to_string(n) +
                                  " px with ranges and amplitudes in all pixels and no edge, got " +
                                  std::to_string(windows.size())
                            : std::string("expected pictures of ranges with amplitudes, got none")));
  std::sort(windows.begin(), windows.end(),
            [](const Window& a, const Window& b) { return a.log_amplitude < b.log_amplitude; });
  // Groups of equal width in ln A between the ends that nearly all windows lie in.
  const auto at = [&](double q) {
    return windows[static_cast<std::size_t>(q * static_cast<double>(windows.size() - 1))].log_amplitude;
  };
  const double from = at(0.002), to = std::max(at(0.998), from + 1e-9);
  const double typical = chi_squared_quantile(0.5, dof) / dof;
  for (int b = 0; b < options.bins; ++b) {
    const double low = from + (to - from) * b / options.bins,
                 high = from + (to - from) * (b + 1) / options.bins;
    std::vector<double> variances, amplitudes_in, inverses, squares;
    for (const Window& w : windows) {
      if (w.log_amplitude < low || w.log_amplitude >= high || !(w.variance_m2 > 0)) continue;
      variances.push_back(w.variance_m2);
      amplitudes_in.push_back(w.log_amplitude);
      inverses.push_back(w.inverse);
      squares.push_back(w.inverse_square);
    }
    if (variances.size() < options.minimum_windows) continue;
    NoiseBin bin;
    bin.samples = variances.size();
    // Steps and texture inside windows make a tail: the median of the windows does not see it.
    bin.variance_m2 = median_of(variances) / typical;
    std::vector<double> away;
    for (const double v : variances)
      away.push_back(std::abs(0.5 * std::log(v / (bin.variance_m2 * typical))));
    const auto count = static_cast<double>(variances.size());
    bin.log_sigma = 1.2533 * 1.4826 * median_of(away) / std::sqrt(count);
    bin.log_sigma = std::max(bin.log_sigma, 1.2533 / std::sqrt(2 * dof * count));
    bin.dof = 1e9;  // the median is of the variance itself: its logarithm has no bias of a few numbers
    bin.amplitude = std::exp(median_of(amplitudes_in));
    for (std::size_t i = 0; i < inverses.size(); ++i) {
      bin.inverse += inverses[i] / count;
      bin.inverse_square += squares[i] / count;
    }
    out.bins.push_back(bin);
  }
  char text[200];
  std::snprintf(
      text, sizeof text,
      "spatial: residuals of a quadratic surface in %dx%d px windows that do not overlap, median of "
      "the windows' variances; contains the fixed pattern",
      n, n);
  out.estimator = text;
  return out;
}

}  // namespace rigor::calibration
