// Residuals of the joint fit, for Ceres. Internal to calibration/photon.
#pragma once

#include "calibration/photon/photon_problem.h"

namespace rigor::calibration::photon {

struct DarkResidual {
  Whitening w;
  double exposure_s, above_reference_k;
  template <class T>
  bool operator()(const T* p, T* r) const {
    using std::exp;
    using std::log;
    const T signal =
        p[kGain] * p[kDark] * T(exposure_s) * exp(T(std::log(2.0) * above_reference_k) / p[kDoubling]);
    w.residual(T(p[kBlack] + signal), T(p[kGain] * p[kGain] * p[kRead] * p[kRead]), p[kGain], signal, r);
    return true;
  }
};
struct LightResidual {
  Whitening w;
  bool dark_level;
  template <class T>
  bool operator()(const T* p, const T* signal, T* r) const {
    const T mean = p[kBlack] + signal[0], fixed = p[kGain] * p[kGain] * p[kRead] * p[kRead];
    // Without a dark level nobody knows how many electrons there are.
    if (dark_level)
      w.residual(mean, fixed, p[kGain], signal[0], r);
    else
      w.residual(mean, T(p[kOffset] + fixed + p[kGain] * signal[0]), T(0), T(0), r);
    return true;
  }
};
/// Above the point where the gain changes: a line of its own.
struct UpperResidual {
  Whitening w;
  double from_dn;
  template <class T>
  bool operator()(const T* p, const T* upper, const T* signal, T* r) const {
    w.residual(T(p[kBlack] + signal[0]), T(upper[1] + upper[0] * (signal[0] - T(from_dn))), T(0), T(0), r);
    return true;
  }
};
struct DsnuResidual {
  double variance_dn2, sigma_dn2;
  template <class T>
  bool operator()(const T* p, const T* dsnu, T* r) const {
    r[0] = (p[kGain] * p[kGain] * dsnu[0] * dsnu[0] - T(variance_dn2)) / T(sigma_dn2);
    return true;
  }
};
struct PrnuResidual {
  double variance, sigma;
  template <class T>
  bool operator()(const T* prnu, T* r) const {
    r[0] = (prnu[0] * prnu[0] - T(variance)) / T(sigma);
    return true;
  }
};
struct FullWellResidual {
  double mean, sigma;
  template <class T>
  bool operator()(const T* p, const T* well, T* r) const {
    r[0] = (p[kBlack] + p[kGain] * well[0] - T(mean)) / T(sigma);
    return true;
  }
};

/// The same of a pixel whose gain has changed before it is full.
struct FullWellAboveResidual {
  double mean, sigma, from_dn;
  template <class T>
  bool operator()(const T* p, const T* upper, const T* well, T* r) const {
    r[0] = (p[kBlack] + T(from_dn) + upper[0] * (well[0] - T(from_dn) / p[kGain]) - T(mean)) / T(sigma);
    return true;
  }
};

struct Nothing {
  template <class T>
  bool operator()(const T* p, T* r) const {
    r[0] = T(0) * p[kGain];
    return true;
  }
};

}  // namespace rigor::calibration::photon
