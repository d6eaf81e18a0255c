// Linearity of a sensor by EMVA 1288: how far the signal is from proportional to the exposure time.
#pragma once

#include "calibration/photon/photon_fit.h"

namespace rigor::calibration {

/// Fills the `linearity…` and `response…` of a fit. The line is fitted to the levels between 5 and 95 % of
/// the saturation with relative weights, as release 4 of the standard has it. Where fewer than three
/// exposures are left, `not_identifiable` says so.
void judge_linearity(const FrameStacks& stacks, PhotonFit& fit);

}  // namespace rigor::calibration
