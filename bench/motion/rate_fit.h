// The acceleration that the last reports of a rate show, for going on past the newest of them.
//
//   rate ▲        ╱ ← latest third: has the ramp ended?
//        │     ╱·
//        │  ·╱ ·            straight-line fit over the last 150 ms
//        └──────────────▶
//
// At constant rate the error after τ is α·τ²/2; with the fit's slope α̂ it is that of the slope, which lies
// half a span behind: jerk·(75 ms)·τ²/2, and jerk·τ³/6.
#pragma once

#include <cmath>
#include <cstddef>

#include "rt-core/time.h"

namespace rigor {

/// A fit takes reports of this span; what is estimated is taken to hold for as long.
inline constexpr Duration kFitSpan = milliseconds(150);

struct RateAt {
  BenchTime t;
  double rate = 0;
};

struct RateFit {
  std::size_t count = 0;
  double slope = 0, sigma = 0;  ///< its standard error; 0 with fewer than three reports
};

/// `rate(k)`, k below `count`, is the k-th report counted back from the newest.
template <class F>
[[nodiscard]] RateFit fit_rate(std::size_t count, Duration span, const F& rate) noexcept {
  RateFit fit;
  if (count == 0) return fit;
  const RateAt newest = rate(0);
  double sx = 0, sy = 0, sxx = 0, sxy = 0, syy = 0;
  for (; fit.count < count; ++fit.count) {
    const RateAt r = rate(fit.count);
    if (newest.t - r.t >= span) break;
    // Against the newest, so that constant rates give exactly zero.
    const double x = (r.t - newest.t).seconds(), y = r.rate - newest.rate;
    sx += x, sy += y, sxx += x * x, sxy += x * y, syy += y * y;
  }
  if (fit.count < 3) return fit;
  const auto n = static_cast<double>(fit.count);
  const double vxx = sxx - sx * sx / n, vxy = sxy - sx * sy / n, vyy = syy - sy * sy / n;
  fit.slope = vxy / vxx;
  fit.sigma = std::sqrt(std::fmax(0, vyy - fit.slope * vxy) / (n - 2) / vxx);
  return fit;
}

/// Zero where fewer than four reports are within the span, or the slope is below three times its standard
/// error. A rate that has become constant shows in the latest third of the span before it does in the whole:
/// where the two disagree, the smaller counts, and zero where their signs differ.
template <class F>
[[nodiscard]] double estimated_acceleration(std::size_t count, const F& rate) noexcept {
  const RateFit whole = fit_rate(count, kFitSpan, rate);
  if (whole.count < 4 || !(std::abs(whole.slope) > 3 * whole.sigma)) return 0;
  const RateFit latest = fit_rate(count, kFitSpan / 3, rate);
  if (latest.count < 3 || std::abs(latest.slope - whole.slope) <= 3 * latest.sigma) return whole.slope;
  if ((latest.slope > 0) != (whole.slope > 0) || latest.slope == 0) return 0;
  return std::abs(latest.slope) < std::abs(whole.slope) ? latest.slope : whole.slope;
}

}  // namespace rigor
