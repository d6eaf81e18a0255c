// The whole way from pictures to parameters, as `rigor calibrate tof` goes it.
#pragma once

#include <utility>
#include <vector>

#include "calibration/tof/noise_law.h"
#include "calibration/tof/range_fit.h"
#include "calibration/tof/scenes.h"
#include "tests/calibration/tof/synthetic_tof.h"

namespace rigor::calibration {

inline const std::vector<double> kDistances{0.7, 0.95, 1.2, 1.45, 1.7, 1.95, 2.2, 2.45};

struct Fitted {
  TofScenes scenes;
  LocalNoise noise;
  NoiseLawFit law;
  RangeFit ranges;
};

/// The whole way, as the command goes it.
inline Result<Fitted> calibrate(std::vector<TofFrame> frames, const models::TofModel& model,
                                const RangeFitOptions& options, NoiseLaw law = NoiseLaw::shot_read,
                                const std::vector<std::size_t>& recording = {}) {
  Fitted out;
  auto scenes = sort_scenes(std::move(frames), recording);
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

/// What is known of it before: nothing of its errors.
inline models::TofModel nominal(models::TofModel m) {
  m.modulation.waveform = models::TofWaveform::sine;
  m.modulation.harmonics = {};
  m.pixel.range_offset_sigma_m = 0;
  m.range_error = {};
  return m;
}

/// One model alone.
inline RangeFitOptions only(RangeModel m, double distance_sigma_m = 1e-3) {
  RangeFitOptions o;
  o.models = {m};
  o.distance_sigma_m = distance_sigma_m;
  return o;
}

}  // namespace rigor::calibration
