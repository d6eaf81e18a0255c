// What must happen where data are poor: the direction that they leave open is named, outliers do not pull,
// units do not matter, and what was not seen is not told as a number.
#include <gtest/gtest.h>

#include <random>

#include "calibration/lidar/rounded_values.h"
#include "tests/calibration/lidar/simulated_room.h"

namespace rigor::calibration {
namespace {

using test::measure;
using test::room;
using test::sixteen_beams;
using test::Truth;

TEST(LidarHardCases, SingleWallLeavesTheSharedBiasOpenAndSaysSo) {
  Truth t;
  t.model = sixteen_beams(0.4);
  t.walls = {room()[0]};
  t.from_rad = -0.12, t.to_rad = 0.12;
  for (std::size_t b = 0; b < 16; ++b) t.model.scan.beams[b].range_bias_m = 0.03 + (b % 2 ? 0.01 : -0.01);
  const auto fit = fit_lidar(measure(t, 10, 3), sixteen_beams(0.4), {.model = "beams"});
  ASSERT_TRUE(fit) << fit.error().text();
  ASSERT_TRUE(fit->bias->common_bias_free);
  ASSERT_FALSE(fit->result.weak.empty());
  EXPECT_NE(fit->result.weak.front().words.find("bias that all beams share from the distance of the wall"),
            std::string::npos)
      << fit->result.weak.front().words;
  EXPECT_FALSE(fit->result.weak.front().cure.empty());
  bool told = false;
  for (const auto& [name, why] : fit->result.not_identifiable) told = told || name == "common_bias_m";
  EXPECT_TRUE(told);
  // Against their mean the biases are still good; the wall's tilt is made up for by what grows with
  // elevation.
  for (std::size_t b = 0; b < 16; ++b) {
    const Parameter* p = fit->result.find("beam_bias_m[" + std::to_string(b) + "]");
    EXPECT_NEAR(p->value, b % 2 ? 0.01 : -0.01, 5 * p->sigma);
    EXPECT_LT(p->sigma, 0.015);
  }
}

TEST(LidarHardCases, ThirtyPercentOutliersDoNotPull) {
  Truth t;
  for (std::size_t b = 0; b < 16; ++b) t.model.scan.beams[b].range_bias_m = 0.003 * static_cast<double>(b);
  t.outliers = 0.3;
  const auto fit = fit_lidar(measure(t, 12, 5), sixteen_beams(), {.model = "beams", .noise_model = "offset"});
  ASSERT_TRUE(fit) << fit.error().text();
  for (std::size_t b = 0; b < 16; ++b) {
    const Parameter* p = fit->result.find("beam_bias_m[" + std::to_string(b) + "]");
    EXPECT_NEAR(p->value, 0.003 * static_cast<double>(b), 5 * p->sigma + 0.0005);
    EXPECT_LT(p->sigma, 0.003);
  }
  EXPECT_NEAR(fit->noise->model.sigma_m(0.4), std::sqrt(0.0063 * 0.0063) / 0.57, 0.0012);
  EXPECT_FALSE(fit->result.rejected.empty());
  EXPECT_NE(fit->result.rejected.front().what.find("beam "), std::string::npos);
}

TEST(LidarHardCases, UnitsDoNotMatter) {
  Truth t;
  for (std::size_t b = 0; b < 16; ++b) t.model.scan.beams[b].range_bias_m = 0.002 * static_cast<double>(b);
  const LidarReturns metres = measure(t, 3, 7);
  const auto a = fit_lidar(metres, sixteen_beams(), {.model = "beams", .noise_model = "offset"});
  ASSERT_TRUE(a) << a.error().text();
  // Powers of two, so that rounding is the same.
  for (const double unit : {1024.0 * 1024, 1 / (1024.0 * 1024)}) {
    LidarReturns other = metres;
    for (auto& r : other.all) r.range_m = static_cast<float>(static_cast<double>(r.range_m) * unit);
    models::LidarModel sensor_model = sixteen_beams();
    sensor_model.range.step_m *= unit;
    const auto b = fit_lidar(other, sensor_model, {.model = "beams", .noise_model = "offset"});
    ASSERT_TRUE(b) << b.error().text();
    for (const char* name : {"beam_bias_m[0]", "beam_bias_m[9]", "noise_scale_m"}) {
      EXPECT_NEAR(b->result.find(name)->value / unit, a->result.find(name)->value,
                  0.01 * a->result.find(name)->sigma)
          << name;
      EXPECT_NEAR(b->result.find(name)->sigma / unit, a->result.find(name)->sigma,
                  0.01 * a->result.find(name)->sigma)
          << name;
    }
  }
}

TEST(LidarHardCases, OneScanIsFittedAndFlagged) {
  Truth t;
  t.model = sixteen_beams(0.5);
  const auto fit = fit_lidar(measure(t, 1, 1), sixteen_beams(0.5));
  ASSERT_TRUE(fit) << fit.error().text();
  ASSERT_TRUE(fit->noise);
  EXPECT_NEAR(fit->noise->model.sigma_m(0.4), 0.0063 / 0.57, 0.002);
  bool said = false;
  for (const auto& w : fit->result.warnings) said = said || w.find("one scan") != std::string::npos;
  EXPECT_TRUE(said);
}

TEST(LidarHardCases, RepeatedScansAreLeftOutAndNamed) {
  const models::LidarModel m = sixteen_beams(2);
  const LidarReturns returns = measure({.model = m}, 1, 1);
  std::vector<LidarPoint> points;
  for (const auto& r : returns.all) {
    const auto aim = models::rotor_aim(m.scan.beams[r.beam], r.azimuth_rad);
    points.push_back({r.range_m * static_cast<float>(aim.direction[0]),
                      r.range_m * static_cast<float>(aim.direction[1]),
                      r.range_m * static_cast<float>(aim.direction[2]), r.remission, 0, r.beam, 0, 0});
  }
  ReturnCollector collector(m.scan);
  for (int i = 0; i < 5; ++i) collector.add(points);
  const LidarReturns once = collector.take();
  EXPECT_EQ(once.scans, 1u);
  EXPECT_EQ(once.duplicate_scans, 4u);
  ASSERT_EQ(once.all.size(), returns.all.size());
  // And a point gives back beam, azimuth and range.
  for (std::size_t i = 0; i < once.all.size(); i += 97) {
    EXPECT_NEAR(once.all[i].range_m, returns.all[i].range_m, 2e-6);
    EXPECT_NEAR(std::remainder(once.all[i].azimuth_rad - returns.all[i].azimuth_rad, 2 * M_PI), 0, 2e-6);
  }
}

TEST(LidarHardCases, NoWallIsSaidAndNoBiasIsTold) {
  std::mt19937_64 random(1);
  std::uniform_real_distribution<double> anywhere(1, 30);
  LidarReturns returns;
  returns.scans = 10;
  models::LidarModel sensor_model = sixteen_beams(4);
  for (std::uint16_t b = 0; b < 16; ++b)
    for (int c = 0; c < 90; ++c) {
      const double range = anywhere(random);
      for (std::uint32_t s = 0; s < 10; ++s)
        returns.all.push_back({static_cast<float>(range + 0.004 * (static_cast<double>(random() % 5) - 2)),
                               40, static_cast<float>(std::remainder(c * 4 * M_PI / 180, 2 * M_PI)), b, s});
    }
  const auto fit = fit_lidar(returns, sensor_model);
  ASSERT_TRUE(fit) << fit.error().text();
  EXPECT_FALSE(fit->bias);
  EXPECT_EQ(fit->result.find("beam_bias_m[0]"), nullptr);
  bool told = false;
  for (const auto& [name, why] : fit->result.not_identifiable)
    told = told || (name == "beam_bias_m" && why.find("wall") != std::string::npos);
  EXPECT_TRUE(told);
  // Nothing to compare and nothing flat: refused.
  returns.scans = 1;
  std::erase_if(returns.all, [](const LidarReturn& r) { return r.scan > 0 || r.beam > 2; });
  EXPECT_FALSE(fit_lidar(returns, sensor_model));
}

TEST(LidarHardCases, FarWallsAreFoundAsNearOnesAre) {
  Truth t;
  for (auto& w : t.walls) w.distance_m *= 12;
  for (std::size_t b = 0; b < 16; ++b) t.model.scan.beams[b].range_bias_m = 0.003 * static_cast<double>(b);
  const auto fit = fit_lidar(measure(t, 4, 2), sixteen_beams(), {.model = "beams", .noise_model = "offset"});
  ASSERT_TRUE(fit) << fit.error().text();
  EXPECT_GE(fit->bias->planes.size(), 3u);
  double mean = 0;
  if (fit->bias->common_bias_free)
    for (int b = 0; b < 16; ++b) mean += 0.003 * b / 16;
  for (std::size_t b = 0; b < 16; ++b) {
    const Parameter* p = fit->result.find("beam_bias_m[" + std::to_string(b) + "]");
    EXPECT_NEAR(p->value, 0.003 * static_cast<double>(b) - mean, 5 * p->sigma);
    EXPECT_LT(p->sigma, 0.01);
  }
}

TEST(LidarHardCases, WhatIsNoNumberTakesNoPart) {
  Truth t;
  LidarReturns returns = measure(t, 4, 6);
  const auto plain = fit_lidar(returns, sixteen_beams(), {.model = "beams", .noise_model = "constant"});
  ASSERT_TRUE(plain) << plain.error().text();
  // A device that tells no remission: everything is taken as white, and nothing of remission is told.
  for (auto& r : returns.all) r.remission = std::numeric_limits<float>::quiet_NaN();
  const auto dark = fit_lidar(returns, sixteen_beams(), {.model = "beams", .noise_model = "constant"});
  ASSERT_TRUE(dark) << dark.error().text();
  for (const Parameter& p : dark->result.parameters) EXPECT_TRUE(std::isfinite(p.value)) << p.name;
  EXPECT_EQ(dark->result.find("remission_noise"), nullptr);
  EXPECT_NEAR(dark->result.find("beam_bias_m[3]")->value, plain->result.find("beam_bias_m[3]")->value, 0.002);
  // Points that are no numbers are not collected.
  ReturnCollector collector(t.model.scan);
  const float nan = std::numeric_limits<float>::quiet_NaN();
  const std::vector<LidarPoint> points{{nan, 0, 0, 1, 0, 0, 0, 0},
                                       {1, nan, 0, 1, 0, 1, 0, 0},
                                       {1, 0, nan, 1, 0, 2, 0, 0},
                                       {0, 0, 0, 1, 0, 3, 0, 0},
                                       {2, 0, 0, 1, 0, 4, 0, 0}};
  collector.add(points);
  EXPECT_EQ(collector.take().all.size(), 1u);
}

TEST(RangeEquation, DerivativesAreThoseOfTheRange) {
  std::mt19937_64 random(3);
  std::uniform_real_distribution<double> u(-1, 1);
  for (int n = 0; n < 200; ++n) {
    models::LidarBeam beam;
    beam.elevation_rad = 0.5 * u(random), beam.vertical_offset_m = 0.02 * u(random);
    beam.horizontal_offset_m = 0.03 * u(random), beam.radial_offset_m = 0.04 * u(random);
    BeamErrors e{0.01, 0.01 * u(random), 0.01 * u(random), 0.02, 0.3, 1.01};
    const double azimuth = 0.8 * u(random), remission = 0.5 + 0.4 * u(random);
    Eigen::Vector3d q = Eigen::Vector3d(1, 0.4 * u(random), 0.4 * u(random)) / 5;
    const auto range = [&] { return predict_range(beam, e, azimuth, remission, q).range_m; };
    const PredictedRange p = predict_range(beam, e, azimuth, remission, q);
    const auto probe = [&](double& x, double h) {
      const double was = x;
      x = was + h;
      const double up = range();
      x = was - h;
      const double down = range();
      x = was;
      return (up - down) / (2 * h);
    };
    EXPECT_NEAR(probe(e.bias_m, 1e-4), 1, 1e-7);
    EXPECT_NEAR(probe(e.elevation_rad, 1e-5), p.d_elevation_m, 1e-6 * (1 + std::abs(p.d_elevation_m)));
    EXPECT_NEAR(probe(e.azimuth_rad, 1e-5), p.d_azimuth_m, 1e-6 * (1 + std::abs(p.d_azimuth_m)));
    EXPECT_NEAR(probe(e.remission_bias_m, 1e-4), p.d_walk, 1e-7);
    EXPECT_NEAR(probe(e.incidence_bias_m, 1e-4), p.d_oblique, 1e-7);
    EXPECT_NEAR(probe(e.scale, 1e-4), p.d_scale_m, 1e-6);
    for (int k = 0; k < 3; ++k)
      EXPECT_NEAR(probe(q[k], 1e-6), p.d_q_m2[k], 2e-5 * (1 + std::abs(p.d_q_m2[k])));
  }
}

/// 3.6 steps of noise, and a third of a step: what the likelihood of rounded values makes of both.
TEST(RoundedValues, SigmaIsFoundWhereDeviationsAreWholeSteps) {
  for (const double sigma : {0.3, 0.6, 3.6}) {
    std::mt19937_64 random(static_cast<std::uint64_t>(sigma * 10));
    std::normal_distribution<double> noise(0, sigma);
    std::uniform_real_distribution<double> anywhere(1000, 2000);
    std::vector<RoundedSeries> series;
    double square = 0, dof = 0;
    for (int c = 0; c < 300; ++c) {
      const double truth = anywhere(random);
      std::map<std::int64_t, std::uint32_t> counts;
      double sum = 0, sum2 = 0;
      for (int i = 0; i < 60; ++i) {
        const double v = std::floor(truth + noise(random) + 0.5);
        ++counts[static_cast<std::int64_t>(v)];
        sum += v - truth, sum2 += (v - truth) * (v - truth);
      }
      square += sum2 - sum * sum / 60, dof += 59;
      series.push_back({{counts.begin(), counts.end()}});
    }
    const RoundedSigma s = sigma_of_rounded(series);
    EXPECT_NEAR(s.sigma, sigma, 3.5 * s.uncertainty) << sigma;
    EXPECT_LT(s.uncertainty, 0.03 * sigma);
    // The variance of rounded values is the one that is said.
    EXPECT_NEAR(square / dof, rounded_variance(sigma), 0.06 * rounded_variance(sigma)) << sigma;
  }
  EXPECT_EQ(rounded_variance(0), 0);
  EXPECT_NEAR(rounded_variance(1), 1 + 1.0 / 12, 1e-12);
}

}  // namespace
}  // namespace rigor::calibration
