// The figures of `rigor calibrate photon`.
#pragma once

#include <vector>

#include "calibration/core/figures.h"
#include "calibration/photon/photon_fit.h"
#include "calibration/photon/twin.h"

namespace rigor {

[[nodiscard]] std::vector<calibration::Figure> photon_figures(
    const calibration::FrameStacks& stacks, const calibration::PhotonFit& fit,
    const std::vector<calibration::NoisePair>& twins);

}  // namespace rigor
