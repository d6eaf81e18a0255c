// What the report of `rigor calibrate tof` shows.
#pragma once

#include <vector>

#include "calibration/core/figures.h"
#include "calibration/tof/drift_fit.h"
#include "calibration/tof/range_fit.h"
#include "calibration/tof/scenes.h"

namespace rigor {

[[nodiscard]] std::vector<calibration::Figure> noise_figures(const calibration::LocalNoise& noise,
                                                             const calibration::NoiseLawFit& law,
                                                             const std::vector<double>& twin_m);
[[nodiscard]] std::vector<calibration::Figure> range_figures(const calibration::RangeFit& fit, int width_px);
[[nodiscard]] std::vector<calibration::Figure> drift_figures(const calibration::DriftFit& fit,
                                                             const std::vector<double>& twin_m);

/// Takes their mean out of the values, to whole steps of the device (0: it has none): where a random walk
/// happens to be is not what a twin is compared in.
void about_own_mean(std::vector<double>& values, double step);

}  // namespace rigor
