#include "calibration/tof/range_fit.h"

#include <gtest/gtest.h>

#include "tests/calibration/tof/coverage.h"
#include "tests/calibration/tof/synthetic_tof.h"

namespace rigor::calibration {
namespace {

const std::vector<double> kDistances{0.7, 0.95, 1.2, 1.45, 1.7, 1.95, 2.2, 2.45};

struct Fitted {
  TofScenes scenes;
  LocalNoise noise;
  NoiseLawFit law;
  RangeFit ranges;
};

/// The whole way, as the command goes it.
Result<Fitted> calibrate(std::vector<TofFrame> frames, const models::TofModel& model,
                         const RangeFitOptions& options, NoiseLaw law = NoiseLaw::shot_read) {
  Fitted out;
  auto scenes = sort_scenes(std::move(frames), {});
  if (!scenes) return tl::unexpected<Error>(scenes.error());
  out.scenes = std::move(*scenes);
  auto noise = temporal_noise(out.scenes, model);
  if (!noise) return tl::unexpected<Error>(noise.error());
  out.noise = std::move(*noise);
  auto fit = fit_noise_law(out.noise.bins, {.laws = {law}});
  if (!fit) return tl::unexpected<Error>(fit.error());
  out.law = std::move(*fit);
  auto ranges = fit_ranges(out.scenes, model, &out.law.noise, options);
  if (!ranges) return tl::unexpected<Error>(ranges.error());
  out.ranges = std::move(*ranges);
  return out;
}

models::TofModel nominal(models::TofModel m) {
  m.modulation.waveform = models::TofWaveform::sine;
  m.modulation.harmonics = {};
  m.pixel.range_offset_sigma_m = 0;
  return m;
}

TEST(RangeFit, RecoversHarmonicsOffsetAndPatternWithTrueUncertainties) {
  Coverage ranges, noise;
  for (std::uint64_t seed = 0; seed < 100; ++seed) {
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

}  // namespace
}  // namespace rigor::calibration
