// Units of an FMU's variables beside those that a rig asks for.
#pragma once

#include <optional>
#include <string>
#include <string_view>

#include "sim/fmu/model_description.h"

namespace rigor::fmu {

/// asked = factor · own + offset
struct Conversion {
  double factor = 1, offset = 0;
  [[nodiscard]] double to_asked(double own) const noexcept { return factor * own + offset; }
  [[nodiscard]] double to_own(double asked) const noexcept { return (asked - offset) / factor; }
};

/// From the unit of a variable to the one that a rig asks for. Known are the units that the FMU defines by
/// base units (FMI 3.0.2, 2.4.5.1), and common ones: m, mm, cm, km, deg, rad, s, ms, min, h, m/s, km/h,
/// deg/s, rad/s, rpm, m/s2, g, kg, t, N, kN, N.m, Nm, J, kJ, W, kW, Pa, kPa, bar, K, degC, A, mA, V, mV, Hz,
/// %, 1. Empty: one of the two is unknown, and they are not the same word, or the two measure different
/// things; `why` says which.
[[nodiscard]] std::optional<Conversion> conversion(const ModelDescription& description, std::string_view own,
                                                   std::string_view asked, std::string& why);

}  // namespace rigor::fmu
