// Pictures of ranges sorted into scenes at rest, with what cannot be used taken out and counted.
#pragma once

#include <string>
#include <utility>
#include <vector>

#include "calibration/core/fit_result.h"
#include "calibration/tof/local_noise.h"
#include "calibration/tof/noise_law.h"
#include "calibration/tof/tof_frames.h"
#include "rt-core/result.h"
#include "sensor-hal/models/tof/tof_model.h"

namespace rigor::calibration {

/// Frames of one plane at one distance, or, where that is not known, of one recording.
struct TofScene {
  std::string name;
  double distance_m = std::numeric_limits<double>::quiet_NaN();
  std::vector<std::size_t> frames;
};

struct TofScenes {
  int width_px = 0, height_px = 0;
  std::vector<TofFrame> frames;
  std::vector<TofScene> scenes;
  double ceiling = 0;  ///< amplitude from which on pixels are saturated; infinite: none found
  /// What was left out, in words; and in numbers.
  std::vector<std::string> notes;
  std::size_t saturated = 0, empty = 0, duplicates = 0;
  [[nodiscard]] std::size_t pixels() const {
    return static_cast<std::size_t>(width_px) * static_cast<std::size_t>(height_px);
  }
};

/// Frames of one recording (`scene_of[i]`; empty: all are of one) with the same distance, or with none, make
/// a scene: a plane that was recorded twice at one distance, bright and dark, makes two. Frames that are
/// copies of others are dropped. Ranges of saturated pixels, and those that are not above 0, become NaN.
/// bad_input: no frames, mixed sizes, no range in any of them.
[[nodiscard]] Result<TofScenes> sort_scenes(std::vector<TofFrame> frames,
                                            const std::vector<std::size_t>& scene_of);

/// Temporal noise: of each pixel over the frames of a scene. Ranges that wrapped are put together again at
/// the model's unambiguous range. Samples beyond five standard deviations are left out: of a million good
/// ones, that takes one. With `harmonics` (a3 … a9) the shot noise's share is that of the light, where the
/// correlation's amplitude varies with the phase. bad_input: no scene with two frames, no amplitudes.
[[nodiscard]] Result<LocalNoise> temporal_noise(const TofScenes& scenes, const models::TofModel& model,
                                                int bins = 48);

/// Noise of the model's pixel by the formula of tof.glsl.h: σ² = p/A + q/A² with A = E·C/2 in units of
/// `electrons` electrons each; p = K²/(C·electrons), q = K²·N²/electrons², K = c/(4π√2·√Σf²), N² = background
/// + read noise² + rounding.
struct PixelNoise {
  double contrast = 0, contrast_sigma = 0;          ///< where the amplitude is in electrons
  double electrons = 0, electrons_sigma = 0;        ///< per unit, where the contrast is taken as known
  double read_noise_e = 0, read_noise_sigma_e = 0;  ///< all that does not depend on the signal
  double floor_m = 0, floor_sigma_m = 0;
};
[[nodiscard]] double phase_noise_constant_m(const models::TofModel& model);
/// From a fit of shot_read or shot_read_floor. `counts`: the amplitude's unit is the device's own, and the
/// model's contrast is taken as known; else it is electrons. Appends parameters (contrast or
/// electrons_per_count, read_noise_e, pixel_floor_m) with their covariance. `range_step_m`: what ranges are
/// rounded to, whose share of the floor is not the pixel's.
[[nodiscard]] FitResult pixel_noise(const NoiseLawFit& fit, const models::TofModel& model, bool counts,
                                    PixelNoise& out, double range_step_m = 0);

}  // namespace rigor::calibration
