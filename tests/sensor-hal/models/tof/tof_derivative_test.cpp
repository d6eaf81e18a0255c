// The time-of-flight pixel over ceres::Jet: derivatives agree with central differences, also next to the
// seams of its reductions.
#include <ceres/jet.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <random>

#include "sensor-hal/models/tof/tof_math.h"

namespace rigor::models {
namespace {

constexpr std::size_t kParameters = 6;  // turns, E, contrast, a3, a5, background
using Jet = ceres::Jet<double, int(kParameters)>;

/// Phase and amplitude of the whole chain without noise.
template <class T>
std::array<T, 2> measured(const std::array<T, kParameters>& p, double bias, double variation) {
  using M = TofMath<T>;
  T x(0.0), y(0.0), d0(0.0), d1(0.0), d2(0.0), d3(0.0), turns(0.0), amplitude(0.0);
  M::tof_phasor(p[0], T(0.0), p[3], p[4], T(0.0), T(0.0), T(bias), T(variation), x, y);
  M::tof_taps(p[1], p[1] * x, p[1] * y, p[2], p[5], d0, d1, d2, d3);
  M::tof_demodulate(d0, d1, d2, d3, turns, amplitude);
  return {turns, amplitude};
}

TEST(TofMath, DerivativesAgreeWithCentralDifferences) {
  std::mt19937 random(4);
  std::uniform_real_distribution<double> uniform;
  for (int i = 0; i < 300; ++i) {
    // Turns next to the seams: eighths and quarters.
    const double turns = i % 3 == 0 ? 0.125 * (i % 24) + 1e-4 : 0.02 + 3 * uniform(random);
    const std::array<double, kParameters> at{turns,
                                             1000 + 9000 * uniform(random),
                                             0.3 + 0.5 * uniform(random),
                                             0.1 * uniform(random),
                                             0.05 * uniform(random),
                                             100 * uniform(random)};
    const double bias = i % 2, variation = i % 4 < 2;
    std::array<Jet, kParameters> jets;
    for (std::size_t k = 0; k < kParameters; ++k) jets[k] = Jet(at[k], int(k));
    const auto value = measured(jets, bias, variation);
    for (std::size_t k = 0; k < kParameters; ++k) {
      auto up = at, down = at;
      const double h = 1e-6 * (1 + std::abs(at[k]));
      up[k] += h;
      down[k] -= h;
      const auto a = measured(up, bias, variation), b = measured(down, bias, variation);
      const double turn = std::remainder(a[0] - b[0], 1.0) / (2 * h);
      EXPECT_NEAR(value[0].v[int(k)], turn, 3e-6 * (1 + std::abs(turn))) << turns << " parameter " << k;
      const double rise = (a[1] - b[1]) / (2 * h);
      // Rounding of an amplitude up to 4000 over h, and the curvature (2 pi)^2 times it.
      EXPECT_NEAR(value[1].v[int(k)], rise, 1e-5 * (1 + std::abs(rise))) << turns << " parameter " << k;
    }
  }
}

TEST(TofMath, SplineIsDifferentiableOnBothSidesOfItsKnotsAndFlatBeyondItsEnds) {
  using J = ceres::Jet<double, 1>;
  const double c[] = {1e-3, -2e-3, 4e-3, 3e-3, -5e-3, 2e-3};
  const auto value = [&](auto r) {
    using T = decltype(r);
    T first(0.0), b[4] = {T(0.0), T(0.0), T(0.0), T(0.0)}, sum(0.0);
    TofMath<T>::tof_spline(r, T(0.5), T(2.0), T(3.0), first, b[0], b[1], b[2], b[3]);
    for (int k = 0; k < 4; ++k)
      if constexpr (std::is_same_v<T, double>)
        sum += c[static_cast<int>(first) + k] * b[k];
      else
        sum += c[static_cast<int>(first.a) + k] * b[k];
    return sum;
  };
  for (double r = 0.3; r < 2.3; r += 0.0137) {
    const double h = 1e-6, slope = (value(r + h) - value(r - h)) / (2 * h);
    EXPECT_NEAR(value(J(r, 0)).v[0], slope, 1e-7) << r;
  }
  EXPECT_EQ(value(J(2.5, 0)).v[0], 0);
  EXPECT_EQ(value(2.5), value(2.0));
}

TEST(TofMath, SigmaIsDifferentiable) {
  using J = ceres::Jet<double, 2>;
  const J s = TofMath<J>::tof_range_sigma(J(0.2), J(5000.0, 0), J(300.0), J(10.0), J(0.5, 1));
  const auto plain = [](double a, double c) { return TofMath<double>::tof_range_sigma(0.2, a, 300, 10, c); };
  EXPECT_NEAR(s.v[0], (plain(5001, 0.5) - plain(4999, 0.5)) / 2, 1e-10);
  EXPECT_NEAR(s.v[1], (plain(5000, 0.5001) - plain(5000, 0.4999)) / 2e-4, 1e-6);
}

}  // namespace
}  // namespace rigor::models
