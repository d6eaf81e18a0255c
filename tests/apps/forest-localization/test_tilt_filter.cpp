#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "apps/forest-localization/tilt_filter.h"

namespace rigor::forest {
namespace {

constexpr double kG = 9.81;

/// A minute on waves of ground with a curve and a stop: rms error of both angles from 10 s on.
struct Drive {
  double accelerometer_bias_mps2 = 0, gyro_bias_radps = 0.017;
  bool wheels = true;
  std::array<double, 2> rms_rad{};

  void run() {
    TiltFilter filter;
    std::mt19937 random(3);
    std::normal_distribution<double> draw;
    double way = 0, sum_roll = 0, sum_pitch = 0;
    int n = 0;
    for (int k = 0; k < 6000; ++k) {
      const double t = 0.01 * k;
      const BenchTime at(static_cast<std::int64_t>(k) * 10'000'000);
      const auto roll = [](double s) { return 0.06 * std::sin(0.4 * s) + 0.02; };
      const auto pitch = [](double s) { return 0.09 * std::sin(0.3 * s + 1) - 0.03; };
      // 0.6 m/s with two halts a second long, braked and set off at 0.8 m/s²; curves in between.
      const auto speed = [](double s) {
        const double u = std::fmod(s, 20.0);
        return u < 15      ? 0.6
               : u < 15.75 ? 0.6 - 0.8 * (u - 15)
               : u < 16.75 ? 0.0
                           : std::min(0.6, 0.8 * (u - 16.75));
      };
      const double v = speed(t), a = (speed(t + 1e-3) - speed(t - 1e-3)) / 2e-3;
      const double yaw_rate = std::fmod(t, 12.0) < 4 ? 0.4 : 0;
      way += v * 0.01;
      const double r = roll(t), p = pitch(t);
      const double r_dot = (roll(t + 1e-4) - roll(t - 1e-4)) / 2e-4,
                   p_dot = (pitch(t + 1e-4) - pitch(t - 1e-4)) / 2e-4;
      const std::array<double, 3> w{
          r_dot - std::sin(p) * yaw_rate + gyro_bias_radps,
          std::cos(r) * p_dot + std::sin(r) * std::cos(p) * yaw_rate - gyro_bias_radps,
          -std::sin(r) * p_dot + std::cos(r) * std::cos(p) * yaw_rate};
      const std::array<double, 3> f{a - kG * std::sin(p) + accelerometer_bias_mps2 + 0.3 * draw(random),
                                    v * yaw_rate + kG * std::cos(p) * std::sin(r) + 0.3 * draw(random),
                                    kG * std::cos(p) * std::cos(r) + 0.3 * draw(random)};
      if (wheels && k % 2 == 0) filter.odometry(at, way);
      filter.imu(at, f, w);
      if (t < 10) continue;
      const Tilt told = filter.at(at);
      sum_roll += std::pow(told.roll_rad - r, 2), sum_pitch += std::pow(told.pitch_rad - p, 2);
      ++n;
    }
    rms_rad = {std::sqrt(sum_roll / n), std::sqrt(sum_pitch / n)};
  }
};

TEST(TiltFilter, FollowsTheGroundWithABiasedGyroscope) {
  Drive drive;
  drive.run();
  EXPECT_LT(drive.rms_rad[0], 0.006);
  EXPECT_LT(drive.rms_rad[1], 0.006);
}

TEST(TiltFilter, WhatTheWheelsAccelerateIsNoGravity) {
  Drive with, without;
  without.wheels = false;
  with.run();
  without.run();
  EXPECT_LT(with.rms_rad[0], 0.8 * without.rms_rad[0]) << "in a curve";
}

TEST(TiltFilter, AnAccelerometersBiasStays) {
  Drive drive;
  drive.accelerometer_bias_mps2 = 0.2;
  drive.run();
  EXPECT_NEAR(drive.rms_rad[1], 0.2 / kG, 0.006);
}

TEST(TiltFilter, LevelledStemsStandWhereALevelScannerSeesThem) {
  // A stem 5 m ahead and 2 m to the left of the vehicle's origin, met 0.62 m above it in the vehicle's frame.
  const Tilt tilt{0.08, -0.1};
  StemObservation stem;
  stem.x_m = 5, stem.y_m = 2;
  const StemObservation level = levelled(stem, 0.62, tilt);
  EXPECT_NEAR(level.x_m, 5 * std::cos(0.1) - std::sin(0.1) * (2 * std::sin(0.08) + 0.62 * std::cos(0.08)),
              1e-12);
  EXPECT_NEAR(level.y_m, 2 * std::cos(0.08) - 0.62 * std::sin(0.08), 1e-12);
  const StemObservation same = levelled(stem, 0.62, {});
  EXPECT_EQ(same.x_m, 5);
  EXPECT_EQ(same.y_m, 2);
}

}  // namespace
}  // namespace rigor::forest
