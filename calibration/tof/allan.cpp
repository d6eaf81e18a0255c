#include "calibration/tof/allan.h"

#include <algorithm>
#include <cmath>

#include "calibration/core/chi_squared.h"

namespace rigor::calibration {
namespace {

/// Exponent of the spectrum from the autocorrelation of neighbours, NIST SP 1065, 5.5.6.
int noise_exponent(std::vector<double> z) {
  for (int d = 0; d < 3; ++d) {
    double mean = 0, zero = 0, one = 0;
    for (const double v : z) mean += v / static_cast<double>(z.size());
    for (std::size_t i = 0; i < z.size(); ++i) {
      zero += (z[i] - mean) * (z[i] - mean);
      if (i > 0) one += (z[i] - mean) * (z[i - 1] - mean);
    }
    if (!(zero > 0)) return 0;
    const double r = one / zero, delta = r / (1 + r);
    if (delta < 0.25 || d == 2) return std::clamp(static_cast<int>(std::lround(-2 * (delta + d))), -2, 2);
    for (std::size_t i = 0; i + 1 < z.size(); ++i) z[i] = z[i + 1] - z[i];
    z.pop_back();
  }
  return 0;
}

/// Equivalent degrees of freedom of the overlapping estimate: `n` points of the running sum, NIST SP 1065,
/// table 5.
double freedom_of(int exponent, double n, double m) {
  switch (exponent) {
    case 2:
    case 1:  // between the two; the smaller
      return (n + 1) * (n - 2 * m) / (2 * (n - m));
    case 0:
      return (3 * (n - 1) / (2 * m) - 2 * (n - 2) / n) * 4 * m * m / (4 * m * m + 5);
    case -1:
      return m == 1 ? 2 * (n - 2) * (n - 2) / (2.3 * n - 4.9) : 5 * n * n / (4 * m * (n + 3 * m));
    default:
      return (n - 2) / m * ((n - 1) * (n - 1) - 3 * m * (n - 1) + 4 * m * m) / ((n - 3) * (n - 3));
  }
}

}  // namespace

std::vector<AllanPoint> overlapping_allan(std::span<const double> series, double period_s) {
  std::vector<AllanPoint> points;
  const std::size_t n = series.size();
  if (n < 8) return points;
  double mean = 0;
  for (const double v : series) mean += v / static_cast<double>(n);
  std::vector<double> sum(n + 1, 0);  // about the mean, so that it does not grow and lose digits
  for (std::size_t i = 0; i < n; ++i) sum[i + 1] = sum[i] + (series[i] - mean);
  int exponent = 0;
  for (std::size_t decade = 1; decade <= n / 4; decade *= 10)
    for (const std::size_t step : {1u, 2u, 5u}) {
      const std::size_t m = decade * step;
      if (m > n / 4) break;
      double squares = 0;
      const std::size_t terms = n - 2 * m + 1;
      for (std::size_t i = 0; i < terms; ++i) {
        const double d = sum[i + 2 * m] - 2 * sum[i + m] + sum[i];
        squares += d * d;
      }
      AllanPoint p;
      p.averaged = m;
      p.tau_s = static_cast<double>(m) * period_s;
      const double width = static_cast<double>(m);
      p.deviation = std::sqrt(squares / static_cast<double>(terms) / (2 * width * width));
      if (n / m >= 30) {  // with fewer the noise type is that of the last τ which had enough
        std::vector<double> averages(n / m);
        for (std::size_t i = 0; i < averages.size(); ++i)
          averages[i] = (sum[(i + 1) * m] - sum[i * m]) / width;
        exponent = noise_exponent(std::move(averages));
      }
      p.exponent = exponent;
      p.freedom = std::max(1.0, freedom_of(exponent, static_cast<double>(n + 1), width));
      p.low = p.deviation * std::sqrt(p.freedom / chi_squared_quantile(0.975, p.freedom));
      p.high = p.deviation * std::sqrt(p.freedom / chi_squared_quantile(0.025, p.freedom));
      points.push_back(p);
    }
  return points;
}

const AllanPoint* averaging_limit(const std::vector<AllanPoint>& points, double sigma) {
  for (const AllanPoint& p : points)
    if (p.low > sigma / std::sqrt(static_cast<double>(p.averaged))) return &p;
  return nullptr;
}

}  // namespace rigor::calibration
