#include "calibration/core/chi_squared.h"

#include <cmath>
#include <limits>

namespace rigor::calibration {

double digamma(double x) {
  double sum = 0;
  for (; x < 10; x += 1) sum -= 1 / x;
  const double i = 1 / (x * x);
  return sum + std::log(x) - 0.5 / x - i * (1. / 12 - i * (1. / 120 - i * (1. / 252 - i / 240)));
}

double trigamma(double x) {
  double sum = 0;
  for (; x < 10; x += 1) sum += 1 / (x * x);
  const double i = 1 / (x * x);
  return sum + 1 / x + 0.5 * i + (i / x) * (1. / 6 - i * (1. / 30 - i * (1. / 42 - i / 30)));
}

double chi_squared_cdf(double x, double dof) {
  if (!(x > 0)) return 0;
  // Regularised incomplete gamma function: its series, or Lentz's continued fraction (Numerical Recipes 6.2).
  const double a = dof / 2, z = x / 2;
  const double front = std::exp(-z + a * std::log(z) - std::lgamma(a));
  if (z < a + 1) {
    double term = 1 / a, sum = term;
    for (double n = a + 1; std::abs(term) > 1e-16 * sum; n += 1) sum += term *= z / n;
    return front * sum;
  }
  double b = z + 1 - a, c = 1e300, d = 1 / b, h = d;
  for (int i = 1; i < 100000; ++i) {
    const double an = -i * (i - a);
    b += 2;
    d = an * d + b;
    if (std::abs(d) < 1e-300) d = 1e-300;
    c = b + an / c;
    if (std::abs(c) < 1e-300) c = 1e-300;
    d = 1 / d;
    h *= d * c;
    if (std::abs(d * c - 1) < 1e-16) break;
  }
  return 1 - front * h;
}

double chi_squared_quantile(double p, double dof) {
  double low = 0, high = dof + 10;
  while (chi_squared_cdf(high, dof) < p) high *= 2;
  for (int i = 0; i < 200 && high - low > 1e-12 * high; ++i) {
    const double middle = 0.5 * (low + high);
    (chi_squared_cdf(middle, dof) < p ? low : high) = middle;
  }
  return 0.5 * (low + high);
}

double student_limit(double sigmas, double dof) {
  if (!(dof >= 1)) return std::numeric_limits<double>::infinity();
  // Hill, Algorithm 396, and Abramowitz and Stegun 26.7.5: the expansion in 1/ν, to 1e-3 from 30 on.
  if (dof >= 30) {
    const double z = sigmas, z2 = z * z;
    return z * (1 + (z2 + 1) / (4 * dof) + (5 * z2 * z2 + 16 * z2 + 3) / (96 * dof * dof) +
                (3 * z2 * z2 * z2 + 19 * z2 * z2 + 17 * z2 - 15) / (384 * dof * dof * dof));
  }
  // Survival function by Simpson's rule over the angle t = √ν·tan: P(|T| > t) = 2·∫ cos^(ν−1) / B(½, ν/2).
  const auto both_tails = [&](double t) {
    const double from = std::atan(t / std::sqrt(dof)), to = std::acos(-1.0) / 2;
    const int n = 400;
    const double h = (to - from) / n;
    double sum = 0;
    for (int i = 0; i <= n; ++i)
      sum += (i == 0 || i == n ? 1
              : i % 2          ? 4
                               : 2) *
             std::pow(std::max(0.0, std::cos(from + i * h)), dof - 1);
    return 2 * sum * h / 3 / std::exp(std::lgamma(0.5) + std::lgamma(dof / 2) - std::lgamma(0.5 + dof / 2));
  };
  const double tails = std::erfc(sigmas / std::sqrt(2.0));
  double low = std::log(sigmas), high = std::log(2 / tails);
  for (int i = 0; i < 60; ++i) {
    const double middle = 0.5 * (low + high);
    (both_tails(std::exp(middle)) > tails ? low : high) = middle;
  }
  return std::exp(0.5 * (low + high));
}

double student_widening(double dof) {
  constexpr double kNormal = 1.959963984540054;
  return student_limit(kNormal, dof) / kNormal;
}

}  // namespace rigor::calibration
