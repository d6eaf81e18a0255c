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

// Any function of a few numbers, over jets and doubles.
template <int N, class F>
void expect_gradient(const std::array<double, N>& at, F function, double tolerance) {
  using J = ceres::Jet<double, N>;
  std::array<J, N> jets;
  for (int i = 0; i < N; ++i) jets[static_cast<std::size_t>(i)] = J(at[static_cast<std::size_t>(i)], i);
  const J value = function(jets);
  EXPECT_NEAR(value.a, function(at), 1e-12 * (1 + std::abs(value.a)));
  for (std::size_t i = 0; i < N; ++i) {
    auto up = at, down = at;
    const double h = 1e-6 * (std::abs(at[i]) + 1e-2);
    up[i] += h;
    down[i] -= h;
    const double slope = (function(up) - function(down)) / (2 * h);
    EXPECT_NEAR(value.v[static_cast<int>(i)], slope, tolerance * (1 + std::abs(slope))) << "argument " << i;
  }
}

TEST(Fisheye, DerivativesAgreeWithCentralDifferences) {
  std::mt19937 random(9);
  std::uniform_real_distribution<double> part(-1, 1);
  for (const KannalaBrandtLens& l : test::kFisheyes)
    for (int i = 0; i < 40; ++i) {
      // On the axis too, where r has no derivative but the projection has.
      const std::array<double, 7> at{i == 0 ? 0.0 : part(random),
                                     i == 0 ? 0.0 : part(random),
                                     i < 20 ? 1.0 : 0.4 * part(random),
                                     l.k1,
                                     l.k2,
                                     l.k3,
                                     l.k4};
      const auto project = [](const auto& p) {
        using T = std::decay_t<decltype(p[0])>;
        T x{}, y{}, valid{};
        LensMath<T>::fisheye_project(p[0], p[1], p[2], p[3], p[4], p[5], p[6], T(3.1), x, y, valid);
        return x + T(2.0) * y;
      };
      expect_gradient<7>(at, project, 1e-7);
      if (i == 0) continue;
      const std::array<double, 6> image{0.9 * part(random), 0.9 * part(random), l.k1, l.k2, l.k3, l.k4};
      const auto unproject = [](const auto& p) {
        using T = std::decay_t<decltype(p[0])>;
        T x{}, y{}, z{}, valid{};
        LensMath<T>::fisheye_unproject(p[0], p[1], p[2], p[3], p[4], p[5], T(2.0), T(1e-15), x, y, z, valid);
        EXPECT_GT(valid, T(0.5));
        return x + T(2.0) * y + T(3.0) * z;
      };
      expect_gradient<6>(image, unproject, 1e-7);
    }
}

TEST(CameraModels, AreDifferentiableOverJets) {
  expect_gradient<5>(
      {1.7, 3.0, 0.012, 2.8, 4.8e-6},
      [](const auto& p) {
        using T = std::decay_t<decltype(p[0])>;
        return LensMath<T>::blur_diameter_px(p[0], p[1], p[2], p[3], p[4]) * T(1e-6);
      },
      1e-5);
  expect_gradient<4>(
      {12.0, 31.0, 25.0, 7.0},
      [](const auto& p) {
        using T = std::decay_t<decltype(p[0])>;
        return NoiseMath<T>::dark_current_at(p[0], p[1], p[2], p[3]);
      },
      1e-7);
  expect_gradient<1>(
      {5000.0},
      [](const auto& p) {
        using T = std::decay_t<decltype(p[0])>;
        return NoiseMath<T>::hot_pixel_rate(T(0.1), p[0], T(0.05), T(0.3));
      },
      1e-7);
  expect_gradient<3>(
      {9.0, 4.0, 1.5},
      [](const auto& p) {
        using T = std::decay_t<decltype(p[0])>;
        return PictureMath<T>::bloom_kernel(p[0], p[1], p[2]) +
               PictureMath<T>::bloom_gaussian_height(p[0], p[2], T(0.7)) +
               PictureMath<T>::bloom_gaussian_sigma(p[0], p[1]) +
               PictureMath<T>::bloom_mix(p[0], p[1], p[2], T(0.1), T(0.02));
      },
      1e-7);
  expect_gradient<4>(
      {900.0, 64.0, 1.3, 1 / 2.2},
      [](const auto& p) {
        using T = std::decay_t<decltype(p[0])>;
        return PictureMath<T>::processed_dn(PictureMath<T>::balanced_dn(p[0], p[1], p[2]), p[1], T(4095.0),
                                            p[3], p[1]);
      },
      1e-6);
}

}  // namespace
}  // namespace rigor::models
