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

}  // namespace rigor
