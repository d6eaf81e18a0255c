// The simulated twin of a calibrated sensor's noise: the levels of the recording, measured again by the
// simulator's own pixel (sensor-hal/models/emva_noise.glsl.h) with the sensor model's values, to be laid
// beside it.
#pragma once

#include <array>
#include <string>
#include <vector>

#include "calibration/photon/photon_fit.h"
#include "sensor-hal/models/camera_model.h"

namespace rigor::calibration {

inline constexpr std::array kNoiseQuantiles{0.001, 0.01, 0.05, 0.25, 0.5, 0.75, 0.95, 0.99, 0.999};

/// Noise of one level, of the recording and of its twin.
struct NoisePair {
  std::string level;
  double signal_dn = 0;
  /// Deviations of the last frame from the mean of the others, scaled to one frame's own noise; of pairs of
  /// exposures those of the second frame from what the sum of both says.
  std::vector<double> real_dn, twin_dn;
  double real_sigma_dn = 0, twin_sigma_dn = 0;
  std::array<double, kNoiseQuantiles.size()> real_quantiles_dn{}, twin_quantiles_dn{};
};

/// Levels that counted in the fit. `sensor_model` has the fitted values; what the fit does not know is the
/// base sensor model's. The same for the same seed. Empty where there is no gain.
[[nodiscard]] std::vector<NoisePair> noise_twins(const FrameStacks& stacks, const PhotonFit& fit,
                                                 const EmvaNoise& sensor_model, std::uint64_t seed);

}  // namespace rigor::calibration
