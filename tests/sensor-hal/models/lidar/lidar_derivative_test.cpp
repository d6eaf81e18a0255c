// The LiDAR and air models over ceres::Jet: derivatives agree with central differences.
#include <ceres/jet.h>
#include <gtest/gtest.h>

#include <array>

#include "sensor-hal/models/air/air_math.h"
#include "sensor-hal/models/lidar/lidar_math.h"

namespace rigor::models {
namespace {

template <std::size_t N, class F>
void expect_derivatives(const std::array<double, N>& at, const F& f) {
  using Dual = ceres::Jet<double, static_cast<int>(N)>;
  std::array<Dual, N> jets;
  for (std::size_t i = 0; i < N; ++i) jets[i] = Dual(at[i], static_cast<int>(i));
  const Dual value = f(jets);
  EXPECT_NEAR(value.a, f(at), 1e-14 * (1 + std::abs(value.a)));
  for (std::size_t i = 0; i < N; ++i) {
    const double h = 1e-5 * std::max(std::abs(at[i]), 0.1);
    auto up = at, down = at;
    up[i] += h;
    down[i] -= h;
    const double slope = (f(up) - f(down)) / (2 * h);
    EXPECT_NEAR(value.v[static_cast<int>(i)], slope, 1e-7 * (1 + std::abs(slope))) << "parameter " << i;
  }
}

TEST(LidarDerivatives, RangeSigmaByItsFourParametersAndPower) {
  const auto f = [](const auto& p) {
    using T = std::decay_t<decltype(p[0])>;
    return LidarMath<T>::lidar_range_sigma_m(p[0], p[1], p[2], p[3], p[4]);
  };
  expect_derivatives<5>({0.3, 0.004, 0.0063, 0.17, 1.0}, f);  // the exponent counts although it is 1
  expect_derivatives<5>({0.02, 0.001, 0.01, 0.0, 0.5}, f);
}

TEST(LidarDerivatives, SurfaceAndUnits) {
  const auto surface = [](const auto& p) {
    using T = std::decay_t<decltype(p[0])>;
    return LidarMath<T>::lidar_surface_remission(p[0], p[1], T(0.2), p[2], p[3], p[4]);
  };
  expect_derivatives<5>({0.7, 0.4, 0.5, 0.1, 30.0}, surface);
  const auto units = [](const auto& p) {
    using T = std::decay_t<decltype(p[0])>;
    return LidarMath<T>::lidar_remission_units(p[0], p[1], p[2], p[3], T(10.0), p[4]);
  };
  expect_derivatives<5>({0.5, 14.0, 100.0, 3.0, 2.0}, units);
  expect_derivatives<5>({5.0, 14.0, 100.0, 3.0, 1.5}, units);
}

TEST(LidarDerivatives, PrismsAndDrops) {
  const auto prisms = [](const auto& p) {
    using T = std::decay_t<decltype(p[0])>;
    T x(0.0), y(0.0), z(0.0);
    LidarMath<T>::lidar_risley_direction(T(1.0), T(0.0), T(0.0), p[0], p[1], p[2], p[3], p[4], x, y, z);
    return T(x + T(2.0) * y + T(3.0) * z);
  };
  expect_derivatives<5>({0.31, 1.0, 0.28, -0.4, 1.51}, prisms);
  const auto drop = [](const auto& p) {
    using T = std::decay_t<decltype(p[0])>;
    return LidarMath<T>::lidar_nearest_drop_m(p[0], T(0.5), p[1], p[2], p[3]);
  };
  expect_derivatives<4>({0.7, 0.01, 0.003, 300.0}, drop);
}

TEST(AirDerivatives, FogRainAndLayers) {
  const auto fog = [](const auto& p) {
    using T = std::decay_t<decltype(p[0])>;
    return AirMath<T>::air_fog_extinction_per_m(p[0], p[1]) * T(1000.0);
  };
  for (const double v : {120.0, 700.0, 2500.0, 20000.0}) expect_derivatives<2>({v, 905.0}, fog);
  const auto rain = [](const auto& p) {
    using T = std::decay_t<decltype(p[0])>;
    return AirMath<T>::air_rain_extinction_per_m(p[0]) * T(1000.0);
  };
  expect_derivatives<1>({8.0}, rain);
  const auto way = [](const auto& p) {
    using T = std::decay_t<decltype(p[0])>;
    return AirMath<T>::air_way_below_m(p[0], p[1], p[2], p[3]);
  };
  expect_derivatives<4>({2.0, 0.5, 50.0, 10.0}, way);
  expect_derivatives<4>({20.0, -0.5, 50.0, 10.0}, way);
}

}  // namespace
}  // namespace rigor::models
