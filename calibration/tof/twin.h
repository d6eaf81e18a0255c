// The simulated twin of a calibrated camera's or sensor's noise: what the fitted model makes of the same
// amplitudes, to be laid beside the recording.
#pragma once

#include <array>
#include <vector>

#include "calibration/tof/drift_fit.h"
#include "calibration/tof/scenes.h"
#include "sensor-hal/models/tof/tof_model.h"

namespace rigor::calibration {

/// Deviations of ranges for the samples' amplitudes, by taps, shot and read noise of the model's pixel
/// (tof.glsl.h) at random phases, with `pixel` in place of the model's noise. The same for the same seed.
[[nodiscard]] std::vector<double> twin_of_pixel(const std::vector<NoiseSample>& samples,
                                                const PixelNoise& pixel, const models::TofModel& model,
                                                std::uint64_t seed);
/// The same by the law alone.
[[nodiscard]] std::vector<double> twin_of_law(const std::vector<NoiseSample>& samples,
                                              const NoiseCoefficients& law, std::uint64_t seed);
/// A series by the fitted noise, with the device's rounding.
[[nodiscard]] std::vector<double> twin_of_series(const DriftFit& fit, std::size_t count, std::uint64_t seed);

inline constexpr std::array kTwinQuantiles{0.01, 0.05, 0.25, 0.5, 0.75, 0.95, 0.99};
/// Of a copy of the values; NaN where there are none.
[[nodiscard]] std::array<double, kTwinQuantiles.size()> quantiles_of(std::vector<double> values);

}  // namespace rigor::calibration
