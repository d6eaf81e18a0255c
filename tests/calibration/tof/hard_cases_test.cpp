// Recordings as they are: copies, missing and saturated pixels, flying pixels, foreign units, wrapped ranges.
#include <gtest/gtest.h>

#include "calibration/tof/drift_fit.h"
#include "calibration/tof/twin.h"
#include "tests/calibration/tof/calibrated.h"

namespace rigor::calibration {
namespace {

SyntheticTof camera() {
  SyntheticTof t{.model = small_tof(), .offset_m = 0.02, .distance_sigma_m = 1e-3};
  t.remission = 0.4;  // nothing saturates
  return t;
}
constexpr const char* kNames[] = {"range_offset_m", "harmonic_3", "harmonic_5", "pixel_offset_sigma_m"};

TEST(HardCases, CopiesOfFramesChangeNeitherValuesNorUncertainties) {
  const SyntheticTof t = camera();
  const auto frames = record_plane(t, kDistances, 3, 11);
  auto twice = frames;
  twice.insert(twice.end(), frames.begin(), frames.end());
  const auto a = calibrate(frames, nominal(t.model), only({2, false, false}));
  const auto b = calibrate(twice, nominal(t.model), only({2, false, false}));
  ASSERT_TRUE(a && b);
  EXPECT_EQ(b->scenes.duplicates, frames.size());
  for (const char* name : kNames) {
    EXPECT_DOUBLE_EQ(a->ranges.result.find(name)->value, b->ranges.result.find(name)->value) << name;
    EXPECT_DOUBLE_EQ(a->ranges.result.find(name)->sigma, b->ranges.result.find(name)->sigma) << name;
  }
}

TEST(HardCases, MissingAndSaturatedPixelsAreLeftOutAndTheRestTellsTheSame) {
  const SyntheticTof t = camera();
  const auto whole = record_plane(t, kDistances, 4, 12);
  auto holes = whole;
  std::mt19937_64 random(2);
  std::uniform_real_distribution<float> share(0, 1);
  for (TofFrame& f : holes)
    for (std::size_t p = 0; p < f.range_m.size(); ++p) {
      if (share(random) < 0.15F) f.range_m[p] = std::nanf("");
      if (share(random) < 0.03F) f.range_m[p] = 0;
      if (share(random) < 0.02F) f.range_m[p] = -1;
      if (share(random) < 0.02F) f.range_m[p] = std::numeric_limits<float>::infinity();
      // A corner in which the light is too strong: amplitudes at the top, ranges of nothing.
      if (p % 24 < 4 && p / 24 < 4) f.amplitude[p] = 4e5F, f.range_m[p] = 0.02F + share(random);
    }
  const auto a = calibrate(whole, nominal(t.model), only({2, false, false}));
  const auto b = calibrate(holes, nominal(t.model), only({2, false, false}));
  ASSERT_TRUE(a) << a.error().text();
  ASSERT_TRUE(b) << b.error().text();
  EXPECT_EQ(b->scenes.saturated, 16 * holes.size());
  EXPECT_EQ(b->scenes.ceiling, 4e5);
  EXPECT_TRUE(std::isnan(b->ranges.pixel_offset_m[0]));
  EXPECT_TRUE(std::isfinite(b->ranges.pixel_offset_m[24 * 9 + 12]));
  for (const char* name : kNames) {
    const Parameter &x = *a->ranges.result.find(name), &y = *b->ranges.result.find(name);
    EXPECT_NEAR(x.value, y.value, 1.5 * y.sigma) << name;
    EXPECT_LT(x.sigma, y.sigma * 1.05) << name;
  }
  EXPECT_LT(b->ranges.result.residuals.rejected, b->ranges.result.residuals.count / 1000 + 5);
}

TEST(HardCases, FlyingPixelsBehindThePlaneDoNotPullIt) {
  const SyntheticTof t = camera();
  const auto clean = record_plane(t, kDistances, 6, 13);
  auto dirty = clean;
  std::mt19937_64 random(3);
  std::uniform_real_distribution<float> share(0, 1);
  std::size_t flying = 0;
  for (TofFrame& f : dirty)
    for (float& r : f.range_m)
      // All on one side: what no mean survives.
      if (share(random) < 0.3F) r = std::min(4.99F, r + 0.05F + 1.5F * share(random)), ++flying;
  const auto a = calibrate(clean, nominal(t.model), only({2, false, false}));
  const auto b = calibrate(dirty, nominal(t.model), only({2, false, false}));
  ASSERT_TRUE(a) << a.error().text();
  ASSERT_TRUE(b) << b.error().text();
  for (const char* name : {"range_offset_m", "harmonic_3", "harmonic_5"}) {
    const Parameter &x = *a->ranges.result.find(name), &y = *b->ranges.result.find(name);
    EXPECT_NEAR(x.value, y.value, 0.5 * x.sigma) << name;
  }
  const double found = static_cast<double>(b->ranges.result.residuals.rejected);
  EXPECT_GT(found, 0.9 * static_cast<double>(flying));
  EXPECT_LT(found, 1.02 * static_cast<double>(flying));
}

TEST(HardCases, TheUnitOfTheAmplitudeChangesNothingElse) {
  SyntheticTof t = camera();
  t.amplitude_error_m = 30;
  std::vector<TofFrame> frames;
  std::vector<std::size_t> recording;
  for (const double remission : {0.2, 0.6}) {
    t.remission = remission;
    for (TofFrame& f : record_plane(t, kDistances, 3, 14, "plane", remission < 0.5 ? 0 : 1000)) {
      frames.push_back(std::move(f));
      recording.push_back(remission < 0.5 ? 0 : 1);
    }
  }
  const auto plain =
      calibrate(frames, nominal(t.model), only({2, false, true}), NoiseLaw::shot_read, recording);
  ASSERT_TRUE(plain) << plain.error().text();
  for (const float unit : {1e-6F, 1e6F}) {
    auto scaled = frames;
    for (TofFrame& f : scaled)
      for (float& a : f.amplitude) a *= unit;
    const auto fit = calibrate(std::move(scaled), nominal(t.model), only({2, false, true}),
                               NoiseLaw::shot_read, recording);
    ASSERT_TRUE(fit) << fit.error().text();
    for (const char* name : kNames) {
      const Parameter &x = *plain->ranges.result.find(name), &y = *fit->ranges.result.find(name);
      EXPECT_NEAR(x.value, y.value, 0.01 * x.sigma) << name << " " << unit;
      EXPECT_NEAR(x.sigma, y.sigma, 0.01 * x.sigma) << name << " " << unit;
    }
    const Parameter &x = *plain->ranges.result.find("amplitude_error_m"),
                    &y = *fit->ranges.result.find("amplitude_error_m");
    EXPECT_NEAR(x.value, y.value / double(unit), 0.01 * x.sigma);
    EXPECT_NEAR(x.sigma, y.sigma / double(unit), 0.01 * x.sigma);
  }
}

TEST(HardCases, TheUnitOfASeriesChangesNothingElse) {
  DriftFit truth;
  truth.white_m = 2e-3, truth.random_walk = 2e-3, truth.mean_m = 1.5, truth.period_s = 0.05;
  const auto y = twin_of_series(truth, 1500, 5);
  const auto plain = fit_drift(y, truth.period_s, {.model = "random_walk"});
  ASSERT_TRUE(plain);
  for (const double unit : {1e-6, 1e6}) {
    auto scaled = y;
    for (double& v : scaled) v *= unit;
    const auto fit = fit_drift(scaled, truth.period_s, {.model = "random_walk"});
    ASSERT_TRUE(fit) << fit.error().text();
    for (std::size_t k = 0; k < plain->result.parameters.size(); ++k) {
      const Parameter &a = plain->result.parameters[k], &b = fit->result.parameters[k];
      EXPECT_NEAR(a.value, b.value / unit, 1e-4 * a.sigma) << a.name;
      EXPECT_NEAR(a.sigma, b.sigma / unit, 1e-4 * a.sigma) << a.name;
    }
  }
}

TEST(HardCases, PlanesBeyondTheUnambiguousRangeAreTakenForWhereTheyStand) {
  // 30 MHz: 5.00 m. All planes beyond it, and the farthest beyond twice it.
  SyntheticTof t = camera();
  t.model.illumination.radiant_intensity_w_per_sr = 40;
  std::vector<double> distances{5.3, 5.5, 5.8, 6.1, 6.4, 6.8, 7.2, 10.4};
  const auto frames = record_plane(t, distances, 4, 15);
  for (const float r : frames.back().range_m) ASSERT_LT(r, 5);
  const auto fit = calibrate(frames, nominal(t.model), only({2, false, false}));
  ASSERT_TRUE(fit) << fit.error().text();
  std::size_t samples = 0;
  for (const TofFrame& f : frames)
    for (const float r : f.range_m) samples += std::isfinite(r);
  EXPECT_GE(fit->ranges.wrapped + 5, samples);
  for (const auto& [name, truth] :
       {std::pair{"range_offset_m", 0.02}, {"harmonic_3", 0.03}, {"harmonic_5", 0.01}})
    EXPECT_NEAR(fit->ranges.result.find(name)->value, truth, 4 * fit->ranges.result.find(name)->sigma)
        << name;
  std::string said;
  for (const std::string& w : fit->ranges.result.warnings) said += w + "\n";
  EXPECT_NE(said.find("wrapped at the unambiguous range of 4.997 m"), std::string::npos) << said;
}

TEST(HardCases, TwoDistancesLeaveTheWigglingAndTheOffsetWeakAndSayIt) {
  SyntheticTof t = camera();
  // A narrow picture: across a wide one ranges run through the period by themselves.
  t.model.fx_px = t.model.fy_px = 20 * t.model.fx_px;
  const auto fit = calibrate(record_plane(t, {1.5, 1.5 + 299792458.0 / 30e6 / 8}, 6, 16), nominal(t.model),
                             only({1, false, false}));
  ASSERT_TRUE(fit) << fit.error().text();
  // A whole period of the wiggling apart: both planes have the same error.
  const FitResult& r = fit->ranges.result;
  ASSERT_FALSE(r.weak.empty());
  EXPECT_GT(r.find("harmonic_3")->sigma, 0.02);
  EXPECT_NE(r.weak[0].words.find("harmonic_3"), std::string::npos) << r.weak[0].words;
  EXPECT_NE(r.weak[0].cure.find("an eighth of the modulation's wavelength"), std::string::npos)
      << r.weak[0].cure;
}

}  // namespace
}  // namespace rigor::calibration
