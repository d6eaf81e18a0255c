// The loop closes: cameras by the simulator's own formulas, whose errors are known, and whether the fits'
// stated uncertainties are true. Seeds 0 … 99.
#include <gtest/gtest.h>

#include "calibration/tof/drift_fit.h"
#include "calibration/tof/saturation.h"
#include "calibration/tof/twin.h"
#include "tests/calibration/tof/calibrated.h"
#include "tests/calibration/tof/coverage.h"

namespace rigor::calibration {
namespace {

/// Distances over two periods of the wiggling at 30 MHz, and more.
std::vector<double> many_distances(double from_m, double to_m, int count) {
  std::vector<double> d;
  for (int i = 0; i < count; ++i) d.push_back(from_m + (to_m - from_m) * i / (count - 1));
  return d;
}

class WigglingOf : public testing::TestWithParam<int> {};

TEST_P(WigglingOf, HarmonicsIsRecoveredWithTrueUncertainties) {
  const int count = GetParam();
  // Of square waves nearly: weak ones of the same error differ in the second order only.
  constexpr double kTruth[] = {0.11, 0.04, 0.02, 0.012};
  Coverage coverage;
  for (std::uint64_t seed = 0; seed < kSeeds; ++seed) {
    SyntheticTof t{.model = small_tof(12, 9), .offset_m = 0.02, .distance_sigma_m = 3e-4, .tilt = 0.03};
    t.model.modulation.harmonics = {};
    for (int k = 0; k < count; ++k) t.model.modulation.harmonics[static_cast<std::size_t>(k)] = kTruth[k];
    t.model.illumination.radiant_intensity_w_per_sr = 0.5;
    if (count == 4) {
      // Of four the sum of the first two is told by the third order alone: by much light and a good bench.
      t.distance_sigma_m = 1e-5;
      t.model.illumination.radiant_intensity_w_per_sr = 100;
      t.model.pixel.full_well_e = 1e9;
    }
    t.remission = 0.4;
    const auto fit = calibrate(record_plane(t, many_distances(0.8, 3.4, 14), 3, seed), nominal(t.model),
                               only({count, false, false}, t.distance_sigma_m));
    ASSERT_TRUE(fit) << fit.error().text();
    std::vector<std::pair<std::string, double>> truth{{"range_offset_m", 0.02},
                                                      {"pixel_offset_sigma_m", 3e-3}};
    for (int k = 0; k < count; ++k) truth.emplace_back("harmonic_" + std::to_string(3 + 2 * k), kTruth[k]);
    coverage.add(fit->ranges.result, truth);
  }
  coverage.expect_true(true);
}

INSTANTIATE_TEST_SUITE_P(OneToFour, WigglingOf, testing::Values(1, 2, 3, 4));

TEST(Wiggling, OfABSplineIsRecoveredWithTrueUncertainties) {
  Coverage coverage;
  for (std::uint64_t seed = 0; seed < kSeeds; ++seed) {
    SyntheticTof t{.model = small_tof(12, 9), .distance_sigma_m = 1e-3, .tilt = 0.03};
    t.model.modulation.waveform = models::TofWaveform::sine;
    t.model.range_error.offset_m = 0.015;
    // The knots are the fit's: from the nearest plane to the farthest corner, one coefficient fewer than
    // scenes.
    double steepest = 1;
    for (const double u : {0.0, t.model.width_px - 1.0})
      for (const double v : {0.0, t.model.height_px - 1.0}) {
        const auto ray = unproject_ray(t.model.camera(), {u, v});
        steepest = std::min(steepest, ray->z / std::hypot(ray->x, ray->y, ray->z));
      }
    const std::vector<double> c{0.004, 0.012, -0.008, 0.015, 0.003, -0.012, 0.006};
    t.model.range_error.wiggling = {kDistances.front(), kDistances.back() / static_cast<float>(steepest), c};
    const auto fit =
        calibrate(record_plane(t, kDistances, 4, seed), nominal(t.model), only({0, true, false}, 1e-3));
    ASSERT_TRUE(fit) << fit.error().text();
    ASSERT_EQ(fit->ranges.spline.coefficients_m.size(), c.size());
    EXPECT_NEAR(fit->ranges.spline.to_m, t.model.range_error.wiggling.to_m, 1e-6);
    std::vector<std::pair<std::string, double>> truth{{"range_offset_m", 0.015 + c[0]},
                                                      {"pixel_offset_sigma_m", 3e-3}};
    for (std::size_t j = 1; j < c.size(); ++j)
      truth.emplace_back("spline_m[" + std::to_string(j) + "]", c[j] - c[0]);
    coverage.add(fit->ranges.result, truth);
  }
  coverage.expect_true(true);
}

TEST(AmplitudeError, IsRecoveredWithTrueUncertainties) {
  Coverage coverage;
  for (std::uint64_t seed = 0; seed < kSeeds; ++seed) {
    SyntheticTof t{.model = small_tof(12, 9), .distance_sigma_m = 5e-4, .tilt = 0.03};
    t.model.range_error.offset_m = -0.01;
    t.model.range_error.amplitude_error_m_e = 40;
    std::vector<TofFrame> frames;
    std::vector<std::size_t> recording;
    for (const double remission : {0.2, 0.7}) {
      t.remission = remission;
      for (TofFrame& f : record_plane(t, kDistances, 2, seed, "plane", remission < 0.5 ? 0 : 1000)) {
        frames.push_back(std::move(f));
        recording.push_back(remission < 0.5 ? 0 : 1);
      }
    }
    const auto fit = calibrate(std::move(frames), nominal(t.model), only({2, false, true}, 5e-4),
                               NoiseLaw::shot_read, recording);
    ASSERT_TRUE(fit) << fit.error().text();
    coverage.add(
        fit->ranges.result,
        {{"range_offset_m", -0.01}, {"harmonic_3", 0.03}, {"harmonic_5", 0.01}, {"amplitude_error_m", 40}});
  }
  coverage.expect_true();
}

/// Groups of samples by a law, their variances drawn from the chi-squared distribution.
std::vector<NoiseBin> drawn_bins(const NoiseCoefficients& law, std::uint64_t seed) {
  std::mt19937_64 random(seed);
  std::vector<NoiseBin> bins;
  for (int i = 0; i < 24; ++i) {
    const double a = 60 * std::pow(1.3, i), sigma = law.sigma_m(a);
    NoiseBin b{.amplitude = a, .inverse = 1 / a, .shot_inverse = 1 / a, .inverse_square = 1 / (a * a)};
    b.dof = 400;
    b.variance_m2 = sigma * sigma * std::chi_squared_distribution<double>(b.dof)(random) / b.dof;
    b.samples = 401;
    bins.push_back(b);
  }
  return bins;
}

TEST(NoiseAgainstAmplitude, IsRecoveredByEveryLawWithTrueUncertainties) {
  for (const auto& truth : {NoiseCoefficients{.law = NoiseLaw::shot, .c = {0.05, 0, 0}},
                            NoiseCoefficients{.law = NoiseLaw::inverse, .c = {0.15, 0, 0}},
                            NoiseCoefficients{.law = NoiseLaw::floor_inverse, .c = {3e-4, 0.15, 0}},
                            NoiseCoefficients{.law = NoiseLaw::shot_read, .c = {1e-3, 0.2, 0}},
                            NoiseCoefficients{.law = NoiseLaw::shot_read_floor, .c = {1e-3, 0.2, 4e-7}}}) {
    Coverage coverage;
    for (std::uint64_t seed = 0; seed < kSeeds; ++seed) {
      const auto fit = fit_noise_law(drawn_bins(truth, seed), {.laws = {truth.law}});
      ASSERT_TRUE(fit) << fit.error().text();
      std::vector<std::pair<std::string, double>> values;
      for (std::size_t k = 0; k < fit->result.parameters.size(); ++k)
        values.emplace_back(fit->result.parameters[k].name, truth.c[k]);
      coverage.add(fit->result, values);
    }
    SCOPED_TRACE(std::string(noise_law_name(truth.law)));
    coverage.expect_true();
  }
}

TEST(Saturation, LevelIsRecoveredWithTrueUncertainties) {
  Coverage coverage;
  for (std::uint64_t seed = 0; seed < kSeeds; ++seed) {
    SyntheticTof t{.model = small_tof(12, 9)};
    t.model.pixel.full_well_e = 250e3 + 1e3 * static_cast<double>(seed);
    t.remission = 1;
    const auto scenes = sort_scenes(record_plane(t, {0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.2}, 4, seed), {});
    ASSERT_TRUE(scenes);
    coverage.add(full_well(*scenes, t.model, 0.5), {{"full_well_e", t.model.pixel.full_well_e}});
  }
  coverage.expect_true();
}

TEST(Drift, RecoversCorrelatedNoiseWithTrueUncertainties) {
  Coverage coverage;
  for (std::uint64_t seed = 0; seed < kSeeds; ++seed) {
    DriftFit truth;
    truth.white_m = 2e-3, truth.correlated_m = 1.5e-3, truth.correlation_s = 0.5, truth.mean_m = 1.5,
    truth.drift_mps = -1e-6, truth.period_s = 0.05;
    const auto fit = fit_drift(twin_of_series(truth, 6000, seed), truth.period_s, {.model = "correlated"});
    ASSERT_TRUE(fit) << fit.error().text();
    coverage.add(fit->result, {{"white_noise_m", 2e-3},
                               {"correlated_noise_m", 1.5e-3},
                               {"correlation_time_s", 0.5},
                               {"mean_range_m", 1.5},
                               {"drift_m_per_s", -1e-6}});
  }
  coverage.expect_true();
}

}  // namespace
}  // namespace rigor::calibration
