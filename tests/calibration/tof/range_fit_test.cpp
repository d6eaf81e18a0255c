#include "calibration/tof/range_fit.h"

#include <gtest/gtest.h>

#include <random>

#include "calibration/tof/saturation.h"
#include "calibration/tof/twin.h"
#include "tests/calibration/tof/calibrated.h"
#include "tests/calibration/tof/coverage.h"

namespace rigor::calibration {
namespace {

TEST(RangeFit, RecoversHarmonicsOffsetAndPatternWithTrueUncertainties) {
  Coverage ranges, noise;
  for (std::uint64_t seed = 0; seed < kSeeds; ++seed) {
    SyntheticTof t{.model = small_tof(), .offset_m = 0.02, .distance_sigma_m = 1e-3, .tilt = 0.03};
    t.remission = 0.3 + 0.06 * static_cast<double>(seed % 10);
    RangeFitOptions o;
    o.models = {{2, false, false}};
    o.distance_sigma_m = 1e-3;
    const auto fit = calibrate(record_plane(t, kDistances, 4, seed), nominal(t.model), o);
    ASSERT_TRUE(fit) << fit.error().text();
    ranges.add(fit->ranges.result, {{"range_offset_m", 0.02},
                                    {"harmonic_3", 0.03},
                                    {"harmonic_5", 0.01},
                                    {"pixel_offset_sigma_m", 3e-3}});
    PixelNoise pixel;
    models::TofModel m = t.model;
    const FitResult p = pixel_noise(fit->law, m, false, pixel);
    noise.add(p, {{"contrast", 0.5}, {"read_noise_e", 100}});
  }
  ranges.expect_true();
  noise.expect_true();
}

TEST(RangeFit, AtASingleDistanceNamesTheDirectionThatIsFree) {
  const SyntheticTof t{.model = small_tof(), .offset_m = 0.02};
  RangeFitOptions o;
  o.distance_sigma_m = 1e-3;
  const auto fit = calibrate(record_plane(t, {1.5}, 6, 1), nominal(t.model), o);
  ASSERT_TRUE(fit) << fit.error().text();
  const FitResult& r = fit->ranges.result;
  EXPECT_TRUE(std::isinf(r.find("harmonic_3")->sigma));
  EXPECT_TRUE(std::isinf(r.find("range_offset_m")->sigma));
  ASSERT_FALSE(r.weak.empty());
  EXPECT_NE(r.weak[0].words.find("harmonic_3"), std::string::npos) << r.weak[0].words;
  EXPECT_NE(r.weak[0].words.find("range_offset_m"), std::string::npos) << r.weak[0].words;
  EXPECT_NE(r.weak[0].words.find("single distance"), std::string::npos) << r.weak[0].words;
  EXPECT_NE(r.weak[0].cure.find("distances"), std::string::npos);
}

TEST(RangeFit, ChoosesTheHarmonicsThatAreThere) {
  SyntheticTof t{.model = small_tof(), .distance_sigma_m = 3e-4};
  t.model.modulation.harmonics = {0.05, 0, 0, 0};
  t.remission = 1;
  RangeFitOptions o;
  o.distance_sigma_m = 3e-4;
  const auto one = calibrate(record_plane(t, kDistances, 4, 2), nominal(t.model), o);
  ASSERT_TRUE(one) << one.error().text();
  EXPECT_EQ(one->ranges.model.harmonics, 1) << one->ranges.result.model;
  t.model.modulation.waveform = models::TofWaveform::sine;
  const auto none = calibrate(record_plane(t, kDistances, 4, 2), nominal(t.model), o);
  ASSERT_TRUE(none) << none.error().text();
  EXPECT_EQ(none->ranges.result.model, "none");
}

TEST(RangeFit, ChoosesNoMoreHarmonicsThanThereAre) {
  int more = 0;
  for (std::uint64_t seed = 0; seed < 4; ++seed) {
    SyntheticTof t{.model = small_tof(12, 9), .distance_sigma_m = 3e-4};
    t.model.modulation.harmonics = {0.05, 0, 0, 0};
    t.remission = 1;
    RangeFitOptions o;
    o.distance_sigma_m = 3e-4;
    const auto fit = calibrate(record_plane(t, kDistances, 4, seed), nominal(t.model), o);
    ASSERT_TRUE(fit) << fit.error().text();
    EXPECT_FALSE(fit->ranges.model.spline);
    EXPECT_GE(fit->ranges.model.harmonics, 1);
    more += fit->ranges.model.harmonics > 1 || fit->ranges.model.amplitude;
  }
  EXPECT_LE(more, 1);
}

TEST(RangeFit, ChoosesTheErrorOfTheAmplitudeWhereThereIsOne) {
  for (std::uint64_t seed = 0; seed < 3; ++seed) {
    SyntheticTof t{.model = small_tof(12, 9), .offset_m = 0.01, .distance_sigma_m = 5e-4};
    t.amplitude_error_m = 60;
    std::vector<TofFrame> frames;
    std::vector<std::size_t> recording;
    for (const double remission : {0.2, 0.8}) {
      t.remission = remission;
      for (TofFrame& f : record_plane(t, kDistances, 4, seed, "plane", remission < 0.5 ? 0 : 1000)) {
        frames.push_back(std::move(f));
        recording.push_back(remission < 0.5 ? 0 : 1);
      }
    }
    RangeFitOptions o;
    o.distance_sigma_m = 5e-4;
    const auto fit = calibrate(std::move(frames), nominal(t.model), o, NoiseLaw::shot_read, recording);
    ASSERT_TRUE(fit) << fit.error().text();
    EXPECT_TRUE(fit->ranges.model.amplitude) << fit->ranges.result.model;
  }
}

/// Of harmonics 3 and 5, which make the same error to first order, the data ask for one: it is off by the
/// other, and its sigma says so. The curve of the error is known all the same.
TEST(RangeFit, TheSigmaOfAHarmonicThatStandsForTwoHoldsTheOther) {
  int alone = 0;
  for (std::uint64_t seed = 0; seed < 2; ++seed) {
    const SyntheticTof t{.model = small_tof(12, 9), .offset_m = 0.02, .distance_sigma_m = 1e-3};
    RangeFitOptions o;
    o.distance_sigma_m = 1e-3;
    const auto fit = calibrate(record_plane(t, kDistances, 4, seed), nominal(t.model), o);
    ASSERT_TRUE(fit) << fit.error().text();
    const FitResult& r = fit->ranges.result;
    if (fit->ranges.model.harmonics != 1) continue;
    ++alone;
    const Parameter& h = *r.find("harmonic_3");
    const auto one = calibrate(record_plane(t, kDistances, 4, seed), nominal(t.model),
                               only({1, false, fit->ranges.model.amplitude}));
    ASSERT_TRUE(one);
    std::printf("harmonic_3 %.5f of 0.03 and 0.01: sigma %.2g, of the model alone %.2g\n", h.value, h.sigma,
                one->ranges.result.find("harmonic_3")->sigma);
    EXPECT_LT(std::abs(h.value - 0.03), 2.5 * h.sigma);
    EXPECT_LT(h.sigma, 0.05);
    for (std::size_t i = 0; i < fit->ranges.curve.size(); ++i)
      EXPECT_NEAR(fit->ranges.curve[i].sigma_m, one->ranges.curve[i].sigma_m, 1e-4);
  }
  EXPECT_GE(alone, 2);
}

/// Much light tells of both, and withheld scenes do not ask for the second: what was found of it is in the
/// sigma of the first, in place of the little that is left open of both.
TEST(RangeFit, TheSigmaOfAHarmonicThatStandsForTwoHoldsWhatWasFoundOfTheOther) {
  int alone = 0;
  for (std::uint64_t seed = 0; seed < 3; ++seed) {
    const SyntheticTof t{.model = small_tof(24, 18), .offset_m = 0.02, .distance_sigma_m = 1e-3};
    RangeFitOptions o;
    o.distance_sigma_m = 1e-3;
    o.models = {{1, false, false}, {2, false, false}};
    const auto fit = calibrate(record_plane(t, kDistances, 60, seed), nominal(t.model), o);
    ASSERT_TRUE(fit) << fit.error().text();
    const Parameter& h = *fit->ranges.result.find("harmonic_3");
    std::printf("%s: harmonic_3 %.5f of 0.03 and 0.01: sigma %.2g\n", fit->ranges.result.model.c_str(),
                h.value, h.sigma);
    if (fit->ranges.model.harmonics != 1) continue;
    ++alone;
    EXPECT_LT(std::abs(h.value - 0.03), 2.5 * h.sigma);
    EXPECT_LT(h.sigma, 0.02);
  }
  EXPECT_GE(alone, 1);
}

TEST(RangeFit, SaysWhichHarmonicsAreNotToldApart) {
  // Harmonics 3 and 5 differ in the second order of their own size: weak ones of the same error do not.
  SyntheticTof t{.model = small_tof(), .offset_m = 0.02, .distance_sigma_m = 1e-3};
  const auto fit = calibrate(record_plane(t, kDistances, 4, 2), nominal(t.model), only({4, false, false}));
  ASSERT_TRUE(fit) << fit.error().text();
  const FitResult& r = fit->ranges.result;
  ASSERT_FALSE(r.weak.empty());
  EXPECT_GT(r.find("harmonic_3")->sigma, 0.02);
  bool both = false;
  for (const WeakDirection& w : r.weak)
    both = both || (w.words.find("harmonic_3") != std::string::npos &&
                    w.words.find("harmonic_5") != std::string::npos);
  EXPECT_TRUE(both) << r.weak[0].words;
}

TEST(RangeFit, EstimatesHowExactTheDistancesAreAndWidensItsIntervals) {
  const SyntheticTof t{.model = small_tof(), .offset_m = 0.02, .distance_sigma_m = 2e-3};
  const auto fit =
      calibrate(record_plane(t, kDistances, 4, 3), nominal(t.model), only({2, false, false}, -1));
  ASSERT_TRUE(fit) << fit.error().text();
  EXPECT_TRUE(fit->ranges.distance_sigma_estimated);
  EXPECT_GT(fit->ranges.distance_sigma_m, 0.8e-3);
  EXPECT_LT(fit->ranges.distance_sigma_m, 5e-3);
  const Parameter& h = *fit->ranges.result.find("harmonic_3");
  EXPECT_NEAR(h.value, 0.03, 3 * h.sigma);
  const auto given =
      calibrate(record_plane(t, kDistances, 4, 3), nominal(t.model), only({2, false, false}, 2e-3));
  ASSERT_TRUE(given);
  EXPECT_GT(h.sigma / fit->ranges.distance_sigma_m,
            1.1 * given->ranges.result.find("harmonic_3")->sigma / 2e-3);
}

TEST(RangeFit, TellsAnErrorOfTheAmplitudeBySurfacesOfSeveralRemissions) {
  SyntheticTof t{.model = small_tof(), .offset_m = 0.01, .amplitude_error_m = 40, .distance_sigma_m = 5e-4};
  std::vector<TofFrame> frames;
  for (const double remission : {0.2, 0.8}) {
    t.remission = remission;
    auto more = record_plane(t, kDistances, 4, 5);
    for (TofFrame& f : more) f.name += remission < 0.5 ? " dark" : " bright";
    frames.insert(frames.end(), more.begin(), more.end());
  }
  // Two recordings of the same distances.
  std::vector<std::size_t> recording(frames.size(), 0);
  std::fill(recording.begin() + static_cast<std::ptrdiff_t>(frames.size() / 2), recording.end(), 1);
  const auto fit = calibrate(std::move(frames), nominal(t.model), only({2, false, true}, 5e-4),
                             NoiseLaw::shot_read, recording);

  ASSERT_TRUE(fit) << fit.error().text();
  const Parameter& k = *fit->ranges.result.find("amplitude_error_m");
  EXPECT_NEAR(k.value, 40, 4 * k.sigma);
  EXPECT_LT(k.sigma, 10);
}

TEST(RangeFit, FindsTheSameWithThirtyPercentOfOutliersAndNamesThem) {
  SyntheticTof t{.model = small_tof(), .offset_m = 0.02, .distance_sigma_m = 1e-3};
  t.remission = 0.4;
  // Nothing saturates.
  const auto clean = record_plane(t, kDistances, 6, 6);
  auto dirty = clean;
  std::mt19937_64 random(1);
  std::uniform_real_distribution<float> anywhere(0.1F, 4.9F), share(0, 1);
  std::size_t outliers = 0;
  for (TofFrame& f : dirty)
    for (float& r : f.range_m)
      if (share(random) < 0.3F) r = anywhere(random), ++outliers;
  const auto a = calibrate(clean, nominal(t.model), only({2, false, false}));
  const auto b = calibrate(dirty, nominal(t.model), only({2, false, false}));
  ASSERT_TRUE(a && b);
  for (const char* name : {"range_offset_m", "harmonic_3", "harmonic_5"}) {
    const Parameter &x = *a->ranges.result.find(name), &y = *b->ranges.result.find(name);
    EXPECT_NEAR(x.value, y.value, 0.5 * x.sigma) << name;
  }
  const double found = static_cast<double>(b->ranges.result.residuals.rejected);
  EXPECT_GT(found, 0.9 * static_cast<double>(outliers));
  EXPECT_LT(found, 1.01 * static_cast<double>(outliers));
  ASSERT_FALSE(b->ranges.result.rejected.empty());
  EXPECT_NE(b->ranges.result.rejected[0].what.find("pixel ("), std::string::npos)
      << b->ranges.result.rejected[0].what;
  EXPECT_NEAR(b->law.noise.c[0], a->law.noise.c[0], 0.2 * a->law.noise.c[0]);
}

TEST(RangeFit, PutsWrappedRangesBack) {
  // Beyond 5 m at 30 MHz: the last two planes come back at 0.2 and 0.5 m.
  SyntheticTof t{.model = small_tof(), .offset_m = 0.01, .distance_sigma_m = 1e-3};
  t.model.illumination.radiant_intensity_w_per_sr = 4;
  const auto fit = calibrate(record_plane(t, {1.0, 1.4, 1.9, 2.5, 3.1, 4.2, 5.2, 5.5}, 4, 7),
                             nominal(t.model), only({2, false, false}));
  ASSERT_TRUE(fit) << fit.error().text();
  EXPECT_GT(fit->ranges.wrapped, 1000u);
  const Parameter& h = *fit->ranges.result.find("harmonic_3");
  EXPECT_NEAR(h.value, 0.03, 4 * h.sigma);
  EXPECT_EQ(fit->ranges.result.residuals.rejected, 0u);
}

TEST(RangeFit, DropsASceneWhoseDistanceWasMistyped) {
  const SyntheticTof t{.model = small_tof(), .offset_m = 0.02, .distance_sigma_m = 1e-3};
  auto frames = record_plane(t, kDistances, 4, 8);
  for (std::size_t i = 4 * 3; i < 4 * 4; ++i) frames[i].distance_m = 1.54;
  const auto fit = calibrate(std::move(frames), nominal(t.model), only({2, false, false}));
  ASSERT_TRUE(fit) << fit.error().text();
  EXPECT_FALSE(fit->ranges.scenes[3].used);
  ASSERT_FALSE(fit->ranges.result.rejected.empty());
  EXPECT_NE(fit->ranges.result.rejected[0].what.find("1.54 m"), std::string::npos)
      << fit->ranges.result.rejected[0].what << "; " << fit->ranges.scenes[0].error_m;
  const Parameter& h = *fit->ranges.result.find("harmonic_3");
  EXPECT_NEAR(h.value, 0.03, 4 * h.sigma);
}

TEST(Scenes, CopiesCountOnceAndSaturatedOrMissingPixelsDoNotCount) {
  const SyntheticTof t{.model = small_tof()};
  auto frames = record_plane(t, {1.0}, 3, 1);
  frames.push_back(frames[0]);
  frames.back().name = "again";
  for (TofFrame& f : frames) f.range_m[5] = std::nanf("");
  for (std::size_t p = 20; p < 60; ++p)
    for (TofFrame& f : frames) f.amplitude[p] = 4e5F;
  const auto scenes = sort_scenes(frames, {});
  ASSERT_TRUE(scenes) << scenes.error().text();
  EXPECT_EQ(scenes->duplicates, 1u);
  EXPECT_EQ(scenes->frames.size(), 3u);
  EXPECT_EQ(scenes->ceiling, 4e5);
  EXPECT_EQ(scenes->saturated, 120u);
  EXPECT_EQ(scenes->empty, 3u);
  EXPECT_TRUE(std::isnan(scenes->frames[1].range_m[30]));
  std::string notes;
  for (const auto& n : scenes->notes) notes += n + "\n";
  EXPECT_NE(notes.find("again: a copy of plane scene 0 frame 0"), std::string::npos) << notes;
  EXPECT_NE(notes.find("saturated"), std::string::npos) << notes;
  frames[1].width_px = 12, frames[1].height_px = 36;
  EXPECT_FALSE(sort_scenes(frames, {}));
  for (TofFrame& f : frames) std::fill(f.range_m.begin(), f.range_m.end(), std::nanf(""));
  EXPECT_FALSE(sort_scenes({frames[0]}, {}));
  EXPECT_FALSE(sort_scenes({}, {}));
}

TEST(RangeFit, OfOneFrameSaysWhatItDoesNotTell) {
  const SyntheticTof t{.model = small_tof(70, 56)};
  const auto scenes = sort_scenes(record_plane(t, {1.2}, 1, 1), {});
  ASSERT_TRUE(scenes);
  EXPECT_FALSE(temporal_noise(*scenes, t.model));
  const auto spatial = spatial_noise(scenes->frames, {});
  ASSERT_TRUE(spatial) << spatial.error().text();
  const auto fit = fit_ranges(*scenes, nominal(t.model), nullptr, {});
  ASSERT_TRUE(fit) << fit.error().text();
  bool said = false;
  for (const auto& [name, why] : fit->result.not_identifiable) said = said || name == "pixel_offset_sigma_m";
  EXPECT_TRUE(said);
  EXPECT_FALSE(fit->result.weak.empty());
}

TEST(Saturation, FullWellLiesBetweenWhatWasMeasuredAndWhatWasNot) {
  SyntheticTof t{.model = small_tof()};
  t.model.pixel.full_well_e = 300e3;
  t.remission = 1;
  const auto scenes = sort_scenes(record_plane(t, {0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.2}, 4, 1), {});
  ASSERT_TRUE(scenes);
  const FitResult well = full_well(*scenes, t.model, 0.5);
  ASSERT_EQ(well.parameters.size(), 1u);
  EXPECT_NEAR(well.parameters[0].value, 300e3, 2 * well.parameters[0].sigma);
  EXPECT_LT(well.parameters[0].sigma, 0.1 * 300e3);
  const auto far = sort_scenes(record_plane(t, {1.5, 2.0}, 4, 1), {});
  const FitResult none = full_well(*far, t.model, 0.5);
  EXPECT_TRUE(none.parameters.empty());
  ASSERT_EQ(none.not_identifiable.size(), 1u);
}

TEST(Twin, OfAPixelHasTheNoiseThatItsLawSays) {
  PixelNoise pixel{.contrast = 0.5, .electrons = 1, .read_noise_e = 100};
  const models::TofModel m = small_tof();
  for (const double a : {2000.0, 20000.0}) {
    const auto twin = twin_of_pixel(std::vector<NoiseSample>(20000, {a, 0}), pixel, m, 3);
    double squares = 0;
    for (const double d : twin) squares += d * d / static_cast<double>(twin.size());
    const double k = phase_noise_constant_m(m);
    EXPECT_NEAR(std::sqrt(squares), k * std::sqrt(a / 0.5 + 1e4) / a,
                0.02 * k * std::sqrt(a / 0.5 + 1e4) / a);
  }
}

}  // namespace
}  // namespace rigor::calibration
