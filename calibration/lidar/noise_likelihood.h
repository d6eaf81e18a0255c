// The likelihood of a LiDAR's models of noise: variances of bins of shots, gamma distributed, rounding in
// them. Not for use beside range_noise.cpp.
#pragma once

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "calibration/lidar/range_noise.h"
#include "calibration/lidar/rounded_values.h"

namespace rigor::calibration::lidar {

using Eigen::Index;
using Eigen::MatrixXd;
using Eigen::VectorXd;

inline double with_rounding(double variance, double step_m) {
  return step_m > 0 ? step_m * step_m * rounded_variance(std::sqrt(variance) / step_m) : variance;
}
inline double without_rounding(double variance, double step_m) {
  if (!(step_m > 0) || !(variance > 0)) return variance;
  if (variance > 0.3 * step_m * step_m) return variance - step_m * step_m / 12;
  double low = 0, high = variance + step_m * step_m;
  for (int i = 0; i < 60; ++i) {
    const double mid = 0.5 * (low + high);
    (with_rounding(mid, step_m) < variance ? low : high) = mid;
  }
  return 0.5 * (low + high);
}

/// Which of floor, scale, offset and exponent a model has; offset and exponent as they are without.
struct Shape {
  const char* name;
  bool floor, scale, offset, exponent;
  double fixed_exponent;
  [[nodiscard]] int parameters() const { return floor + scale + offset + exponent; }
};
inline constexpr Shape kShapes[] = {{"constant", true, false, false, false, 1},
                                    {"photon", false, true, false, false, 0.5},
                                    {"photon+floor", true, true, false, false, 0.5},
                                    {"power", false, true, false, true, 1},
                                    {"offset", false, true, true, false, 1},
                                    {"offset+floor", true, true, true, false, 1},
                                    {"full", true, true, true, true, 1}};

/// Shots of about one remission together.
struct Bin {
  double remission = 0, variance = 0, dof = 0;
  int band = 0;
};

/// Unknowns are logarithms (of floor, scale, offset) and the exponent: none can leave its bounds, and the
/// unit of length does not matter.
struct Guess {
  std::array<double, 4> t{};  ///< log floor, log scale, log offset, exponent
  [[nodiscard]] NoiseModel model(const Shape& s) const {
    NoiseModel m;
    m.floor_m = s.floor ? std::exp(t[0]) : 0;
    m.scale_m = s.scale ? std::exp(t[1]) : 0;
    m.offset = s.offset ? std::exp(t[2]) : 0;
    m.exponent = s.exponent ? t[3] : s.fixed_exponent;
    return m;
  }
};
inline std::array<bool, 4> free_of(const Shape& s) { return {s.floor, s.scale, s.offset, s.exponent}; }

class Likelihood {
 public:
  Likelihood(const std::vector<Bin>& bins, double step_m, double minimum_remission)
      : bins_(bins), step_m_(step_m), least_(minimum_remission) {}

  [[nodiscard]] double variance(const NoiseModel& m, double remission) const {
    const double s = m.sigma_m(std::max(remission, least_));
    return with_rounding(s * s, step_m_);
  }
  /// −2 log likelihood but for constants.
  [[nodiscard]] double deviance(const NoiseModel& m, int withheld) const {
    double sum = 0;
    for (const Bin& b : bins_) {
      if (b.band == withheld) continue;
      const double v = std::max(1e-300, variance(m, b.remission));
      sum += b.dof * (b.variance / v + std::log(v));
    }
    return sum;
  }
  /// Fisher scoring with a damped step; `information` of the free unknowns.
  double fit(const Shape& s, Guess& g, int withheld, MatrixXd* information = nullptr) const {
    const auto free = free_of(s);
    const auto n = static_cast<Index>(s.parameters());
    double now = deviance(g.model(s), withheld), damping = 1e-6;
    for (int round = 0; round < 80; ++round) {
      MatrixXd h = MatrixXd::Zero(n, n);
      VectorXd right = VectorXd::Zero(n);
      std::array<Guess, 4> up, down;
      constexpr double kStep = 1e-5;
      Index k = 0;
      for (std::size_t i = 0; i < 4; ++i)
        if (free[i]) {
          const auto at = static_cast<std::size_t>(k++);
          up[at] = down[at] = g;
          up[at].t[i] += kStep, down[at].t[i] -= kStep;
        }
      VectorXd d(n);
      for (const Bin& b : bins_) {
        if (b.band == withheld) continue;
        const double v = std::max(1e-300, variance(g.model(s), b.remission));
        for (Index i = 0; i < n; ++i) {
          const auto at = static_cast<std::size_t>(i);
          d[i] = std::log(variance(up[at].model(s), b.remission) / variance(down[at].model(s), b.remission)) /
                 (2 * kStep);
        }
        h += 0.5 * b.dof * d * d.transpose();
        right += 0.5 * b.dof * (b.variance / v - 1) * d;
      }
      if (information) *information = h;
      MatrixXd damped = h;
      for (Index i = 0; i < n; ++i) damped(i, i) += damping * h(i, i) + 1e-9;
      const VectorXd step = damped.ldlt().solve(right);
      Guess next = g;
      k = 0;
      for (std::size_t i = 0; i < 4; ++i)
        if (free[i]) next.t[i] += std::clamp(step[k++], -1.0, 1.0);
      next.t[3] = std::clamp(next.t[3], 0.02, s.offset ? 8.0 : 4.0);
      for (std::size_t i = 0; i < 3; ++i) next.t[i] = std::clamp(next.t[i], g_low_[i], g_high_[i]);
      const double then = deviance(next.model(s), withheld);
      if (std::isfinite(then) && then <= now + 1e-9 * std::abs(now)) {
        const bool done = now - then < 1e-5;
        g = next, now = then, damping = std::max(1e-9, damping / 5);
        if (done) break;
      } else {
        damping = std::max(damping * 10, 1e-4);
        if (damping > 1e8) break;
      }
    }
    return now;
  }
  /// Bounds of the logarithms.
  std::array<double, 3> g_low_{-60, -60, -14}, g_high_{60, 60, 14};

 private:
  const std::vector<Bin>& bins_;
  double step_m_, least_;
};

}  // namespace rigor::calibration::lidar
