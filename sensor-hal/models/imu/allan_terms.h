// What the Allan deviation of an inertial sensor is made of (IEEE Std 952-1997, annex C), over any number
// type: a calibrator fits these to a measured curve, a simulator draws noise that has it.
//
//   term                     density of the power spectrum    variance at τ
//   white (random walk of    N²                               N²/τ
//     the integral)
//   bias instability         B²/(2π f)                        (2 ln 2/π)·B², flat: 0.664·B
//   random walk of the rate  (K/2πf)²                         K²·τ/3
//   Gauss–Markov             (q T)²/(1 + (2πfT)²)             markov_variance
//
// Spectra are two-sided, as in the standard. Data sheets state the density of white noise over positive
// frequencies alone, n: N = n/√2. So an ADIS16470 with 0.008 (°/s)/√Hz has an angle random walk of
// 0.008/√2·60 = 0.34 °/√h, as its data sheet says too.
#pragma once

#include <cmath>
#include <numbers>

namespace rigor::models {

/// √(2 ln 2/π): the floor of the Allan deviation over B.
inline constexpr double kFloorOfInstability = 0.6642825;
/// The largest Allan deviation of a Gauss–Markov process over its standard deviation, at τ = 1.8926 T.
inline constexpr double kPeakOfMarkov = 0.617364;

/// Allan variance of a stationary Gauss–Markov process of standard deviation `sigma` and correlation time
/// T: 2σ²T/τ·(1 − T/(2τ)·(3 − 4e^(−τ/T) + e^(−2τ/T))).
template <class REAL>
REAL markov_variance(const REAL& sigma, const REAL& correlation_s, const REAL& tau_s) {
  using std::exp;
  const REAL x = tau_s / correlation_s;
  return REAL(2) * sigma * sigma / x *
         (REAL(1) - (REAL(3) - REAL(4) * exp(-x) + exp(REAL(-2) * x)) / (REAL(2) * x));
}

template <class REAL>
struct AllanTerms {
  REAL white{0};          ///< N [unit·√s]
  REAL instability{0};    ///< B [unit]
  REAL correlation_s{1};  ///< of the Gauss–Markov process that stands for B
  REAL random_walk{0};    ///< K [unit/√s]
};
/// Standard deviation of the Gauss–Markov process whose Allan deviation peaks at the floor 0.664·B.
template <class REAL>
REAL markov_sigma(const REAL& instability) {
  return instability * REAL(kFloorOfInstability / kPeakOfMarkov);
}
template <class REAL>
REAL allan_variance(const AllanTerms<REAL>& t, const REAL& tau_s) {
  return t.white * t.white / tau_s + markov_variance(markov_sigma(t.instability), t.correlation_s, tau_s) +
         t.random_walk * t.random_walk * tau_s / REAL(3);
}

}  // namespace rigor::models
