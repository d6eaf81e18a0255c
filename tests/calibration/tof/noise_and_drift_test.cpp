#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <random>

#include "calibration/tof/drift_fit.h"
#include "calibration/tof/local_noise.h"
#include "calibration/tof/twin.h"
#include "tests/calibration/tof/coverage.h"
#include "tests/calibration/tof/synthetic_tof.h"
#include "tests/paths.h"

namespace rigor::calibration {
namespace {

namespace fs = std::filesystem;

fs::path recording(const std::string& name) { return rigor::test::test_data(name); }

#define NEED_RECORDING(path) \
  if (!fs::exists(path)) GTEST_SKIP() << "test data: " << path << " is not here"

std::vector<std::uint16_t> words_of(const fs::path& file) {
  std::ifstream in(file, std::ios::binary);
  std::vector<std::uint16_t> out;
  for (char b[2]; in.read(b, 2);)
    out.push_back(
        static_cast<std::uint16_t>(static_cast<unsigned char>(b[0]) | static_cast<unsigned char>(b[1]) << 8));
  return out;
}

TEST(ChiSquared, AgreesWithPublishedValues) {
  EXPECT_NEAR(chi_squared_quantile(0.975, 10), 20.4832, 1e-4);  // NIST/SEMATECH e-Handbook, 1.3.6.7.4
  EXPECT_NEAR(chi_squared_quantile(0.025, 10), 3.2470, 1e-4);
  EXPECT_NEAR(chi_squared_quantile(0.95, 1), 3.8415, 1e-4);
  EXPECT_NEAR(digamma(1), -0.5772156649, 1e-9);
  EXPECT_NEAR(trigamma(1), 1.6449340668, 1e-9);
  EXPECT_NEAR(student_widening(5) * 1.959964, 2.5706, 1e-3);
  EXPECT_NEAR(student_widening(1) * 1.959964, 12.706, 0.05);
}

TEST(SpatialNoise, OfAnAzureKinectFollowsAPlusBOverAAndNotOneOverTheRoot) {
  const auto depth_file = recording("azure_kinect_tof/depth_640x576_u16le.raw");
  NEED_RECORDING(depth_file);
  const auto depth = words_of(depth_file),
             amplitude = words_of(recording("azure_kinect_tof/ir_640x576_u16le.raw"));
  TofFrame f{.name = "azure kinect", .width_px = 640, .height_px = 576};
  for (const auto v : depth) f.range_m.push_back(1e-3F * v);
  f.amplitude.assign(amplitude.begin(), amplitude.end());
  const auto noise = spatial_noise({&f, 1}, {.window_px = 7});
  ASSERT_TRUE(noise) << noise.error().text();
  EXPECT_NE(noise->estimator.find("7x7"), std::string::npos);
  NoiseLawOptions two;
  two.laws = {NoiseLaw::shot, NoiseLaw::floor_inverse};
  const auto law = fit_noise_law(noise->bins, two);
  ASSERT_TRUE(law) << law.error().text();
  EXPECT_EQ(law->noise.law, NoiseLaw::floor_inverse);
  EXPECT_LE(law->misfit, 0.06);
  EXPECT_GT(law->misfits[0], 0.15);
  // 0.295 mm + 144 mm/A is what another made of the same picture with these windows.
  EXPECT_NEAR(law->noise.c[0], 0.295e-3, 0.02e-3);
  EXPECT_NEAR(law->noise.c[1], 0.144, 0.01);
  // b moves with the window, as FACTS of such a camera are: a smaller one sees less of it.
  const auto small = spatial_noise({&f, 1}, {.window_px = 5});
  ASSERT_TRUE(small);
  EXPECT_LT(fit_noise_law(small->bins, two)->noise.c[1], 0.85 * law->noise.c[1]);
}

TEST(NoiseLaw, DoesNotDependOnTheUnitsOfRangeAndAmplitude) {
  std::mt19937_64 random(3);
  std::vector<NoiseBin> bins;
  for (int i = 0; i < 20; ++i) {
    const double a = 100 * std::pow(1.3, i), sigma = 3e-4 + 0.15 / a;
    NoiseBin b{.amplitude = a, .inverse = 1 / a, .shot_inverse = 1 / a, .inverse_square = 1 / (a * a)};
    b.dof = 500;
    b.variance_m2 = sigma * sigma * std::chi_squared_distribution<double>(500)(random) / 500;
    bins.push_back(b);
  }
  const auto plain = fit_noise_law(bins, {});
  ASSERT_TRUE(plain);
  EXPECT_EQ(plain->noise.law, NoiseLaw::floor_inverse);
  for (const double unit : {1e-6, 1e6}) {
    auto scaled = bins;
    for (NoiseBin& b : scaled) {
      b.amplitude *= unit, b.inverse /= unit, b.shot_inverse /= unit, b.inverse_square /= unit * unit;
      b.variance_m2 *= unit * unit;
    }
    const auto fit = fit_noise_law(scaled, {});
    ASSERT_TRUE(fit);
    EXPECT_EQ(fit->noise.law, plain->noise.law);
    EXPECT_NEAR(fit->noise.c[0], plain->noise.c[0] * unit, 1e-6 * plain->noise.c[0] * unit);
    EXPECT_NEAR(fit->noise.c[1], plain->noise.c[1] * unit * unit, 1e-6 * plain->noise.c[1] * unit * unit);
    EXPECT_NEAR(fit->result.parameters[0].sigma, plain->result.parameters[0].sigma * unit,
                1e-4 * plain->result.parameters[0].sigma * unit);
  }
}

TEST(NoiseLaw, SaysThatAFloorIsNotThereInsteadOfZero) {
  std::vector<NoiseBin> bins;
  for (int i = 0; i < 12; ++i) {
    const double a = 100 * std::pow(1.3, i);
    NoiseBin b{.amplitude = a, .inverse = 1 / a, .shot_inverse = 1 / a, .inverse_square = 1 / (a * a)};
    b.dof = 200, b.variance_m2 = 0.02 / (a * a);
    bins.push_back(b);
  }
  const auto fit = fit_noise_law(bins, {.laws = {NoiseLaw::floor_inverse}});
  ASSERT_TRUE(fit);
  ASSERT_FALSE(fit->result.not_identifiable.empty());
  EXPECT_EQ(fit->result.not_identifiable[0].first, "noise_floor_m");
  EXPECT_NE(fit->result.not_identifiable[0].second.find("below"), std::string::npos);
}

TEST(Allan, OfWhiteNoiseFallsAsTheRootAndItsIntervalsHold) {
  int inside = 0, all = 0;
  for (std::uint64_t seed = 0; seed < 100; ++seed) {
    std::mt19937_64 random(seed);
    std::normal_distribution<double> normal(5, 2e-3);
    std::vector<double> y(2000);
    for (double& v : y) v = normal(random);
    for (const AllanPoint& p : overlapping_allan(y, 0.1)) {
      if (p.averaged != 10 && p.averaged != 100) continue;
      const double truth = 2e-3 / std::sqrt(static_cast<double>(p.averaged));
      inside += p.low < truth && truth < p.high;
      ++all;
    }
  }
  EXPECT_EQ(all, 200);
  EXPECT_NEAR(inside, 190, 3.2905 * std::sqrt(200 * 0.95 * 0.05) + 0.5);
}

TEST(Drift, RecoversWhiteNoiseAndRandomWalkWithTrueUncertainties) {
  Coverage coverage;
  for (std::uint64_t seed = 0; seed < 100; ++seed) {
    DriftFit truth;
    truth.white_m = 2e-3, truth.random_walk = 2e-3, truth.mean_m = 1.5, truth.drift_mps = 1e-3,
    truth.period_s = 0.05;
    auto y = twin_of_series(truth, 1500, seed);
    // The walk begins at 0 with the first reading: the mean that is fitted has it, so that is not compared.
    const auto fit = fit_drift(y, truth.period_s, {.model = "random_walk"});
    ASSERT_TRUE(fit) << fit.error().text();
    coverage.add(fit->result,
                 {{"white_noise_m", 2e-3}, {"random_walk_m_per_sqrt_s", 2e-3}, {"drift_m_per_s", 1e-3}});
  }
  coverage.expect_true();
}

TEST(Drift, OfWhiteNoiseAloneIsNotFound) {
  DriftFit truth;
  truth.white_m = 2e-3, truth.mean_m = 1.5, truth.period_s = 0.05;
  const auto fit = fit_drift(twin_of_series(truth, 3000, 4), truth.period_s, {});
  ASSERT_TRUE(fit);
  EXPECT_EQ(fit->result.model, "white");
  EXPECT_EQ(fit->averaging_limit, 0u);
  ASSERT_FALSE(fit->result.not_identifiable.empty());
  EXPECT_EQ(fit->result.not_identifiable[0].first, "drift_m_per_s");
}

TEST(Drift, NamesOutliersAndBridgesGaps) {
  DriftFit truth;
  truth.white_m = 2e-3, truth.random_walk = 1e-3, truth.mean_m = 1.5, truth.period_s = 0.05;
  auto y = twin_of_series(truth, 2000, 9);
  y[700] = 3;
  for (std::size_t i = 1000; i < 1040; ++i) y[i] = std::nan("");
  const auto fit = fit_drift(y, truth.period_s, {.model = "random_walk", .name = "bench.csv"});
  ASSERT_TRUE(fit) << fit.error().text();
  ASSERT_EQ(fit->result.rejected.size(), 1u);
  EXPECT_NE(fit->result.rejected[0].what.find("bench.csv reading 700"), std::string::npos);
  EXPECT_NEAR(fit->white_m, 2e-3, 5 * fit->result.parameters[0].sigma);
  EXPECT_FALSE(fit_drift(std::vector<double>(500, 1.0), 0.1, {}));
  EXPECT_FALSE(fit_drift(std::vector<double>(50, 1.0), 0.1, {}));
}

TEST(Drift, OfARealVl53l0xStopsTheGainOfAveraging) {
  const auto file = recording("vl53l0x_tof/static_tof_dist_data_1_h.csv");
  NEED_RECORDING(file);
  std::ifstream in(file);
  std::string line;
  for (int i = 0; i < 3; ++i) std::getline(in, line);
  std::vector<double> y;
  // A quarter of an hour tells; the whole takes longer.
  while (y.size() < 50000 && std::getline(in, line)) y.push_back(1e-3 * std::stod(line));
  const auto fit = fit_drift(y, 1 / 44.3, {.model = "correlated+random_walk"});
  ASSERT_TRUE(fit) << fit.error().text();
  EXPECT_EQ(fit->step_m, 1e-3);
  EXPECT_NEAR(fit->white_m, 2.08e-3, 0.05e-3);
  EXPECT_GT(fit->averaging_limit, 5u);
  EXPECT_LE(fit->averaging_limit, 200u);
  EXPECT_GT(fit->minimum_deviation_m, 0.1e-3);
  ASSERT_FALSE(fit->result.warnings.empty());
  EXPECT_NE(fit->result.warnings[0].find("1/sqrt(N) up to about"), std::string::npos);
  // Of the last τ the white noise alone would say a tenth.
  const AllanPoint* at = nullptr;
  for (const AllanPoint& p : fit->allan)
    if (p.averaged == 2000) at = &p;
  ASSERT_NE(at, nullptr);
  EXPECT_GT(at->low, 3 * fit->white_m / std::sqrt(2000.0));
}

}  // namespace
}  // namespace rigor::calibration
