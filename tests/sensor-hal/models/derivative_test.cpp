// The models over ceres::Jet: they compile, and their derivatives agree with central differences, at random
// points and where a formula changes its branch.
#include <ceres/jet.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <random>

#include "sensor-hal/models/one_source.h"
#include "tests/sensor-hal/models/test_lenses.h"

namespace rigor::models {
namespace {

constexpr int kParameters = 10;  // x, y, k1, k2, p1, p2, k3, k4, k5, k6
using Jet = ceres::Jet<double, kParameters>;
using Parameters = std::array<double, kParameters>;

template <class T>
std::array<T, 2> distort(const std::array<T, kParameters>& p) {
  std::array<T, 2> out{};
  LensMath<T>::lens_distort(p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7], p[8], p[9], out[0], out[1]);
  return out;
}
template <class T>
std::array<T, 2> undistort(const std::array<T, kParameters>& p) {
  std::array<T, 2> out{};
  T valid{};
  LensMath<T>::lens_undistort(p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7], p[8], p[9], T(1e-13), out[0],
                              out[1], valid);
  EXPECT_GT(valid, T(0.5));
  return out;
}

template <class F, class G>
void expect_derivatives(const Parameters& at, F over_jets, G over_doubles) {
  std::array<Jet, kParameters> jets;
  for (int i = 0; i < kParameters; ++i)
    jets[static_cast<std::size_t>(i)] = Jet(at[static_cast<std::size_t>(i)], i);
  const std::array<Jet, 2> value = over_jets(jets);
  for (std::size_t i = 0; i < kParameters; ++i) {
    const double h = 1e-5;
    Parameters up = at, down = at;
    up[i] += h;
    down[i] -= h;
    const auto a = over_doubles(up), b = over_doubles(down);
    // Truncation h^2 f'''/6 with f''' below 50, rounding 1e-16/h.
    for (std::size_t k = 0; k < 2; ++k)
      EXPECT_NEAR(value[k].v[static_cast<int>(i)], (a[k] - b[k]) / (2 * h),
                  2e-9 * (1 + std::abs(value[k].v[static_cast<int>(i)])))
          << "parameter " << i;
  }
}

TEST(OpenCvLens, DerivativesAgreeWithCentralDifferences) {
  std::mt19937 random(4);
  std::uniform_real_distribution<double> xy(-0.4, 0.4);
  for (const OpenCvLens& l : test::kLenses)
    for (int i = 0; i < 50; ++i) {
      // Some at the axis itself, where r is 0.
      const Parameters at{i == 0 ? 0.0 : xy(random),
                          i <= 1 ? 0.0 : xy(random),
                          l.k1,
                          l.k2,
                          l.p1,
                          l.p2,
                          l.k3,
                          l.k4,
                          l.k5,
                          l.k6};
      expect_derivatives(at, distort<Jet>, distort<double>);
      if (i > 0 && i < 20) expect_derivatives(at, undistort<Jet>, undistort<double>);
    }
}

TEST(EmvaNoise, MeanAndAnalogueValueAreDifferentiable) {
  using J = ceres::Jet<double, 2>;
  const J rate(1000.0, 0), gain(0.4, 1);
  const J mean = NoiseMath<J>::emva_mean_electrons(rate, J(10.0), J(0.9), J(0.01));
  const J y = NoiseMath<J>::emva_analogue_dn(mean, gain, J(64.0));
  EXPECT_NEAR(y.v[0], 0.4 * 0.9 * 0.01, 1e-12);
  EXPECT_NEAR(y.v[1], (1000 * 0.9 + 10) * 0.01, 1e-12);
  const J z = NoiseMath<J>::normal_quantile(J(0.3, 0));
  const double h = 1e-6;
  EXPECT_NEAR(
      z.v[0],
      (NoiseMath<double>::normal_quantile(0.3 + h) - NoiseMath<double>::normal_quantile(0.3 - h)) / (2 * h),
      1e-6);
}

}  // namespace
}  // namespace rigor::models
