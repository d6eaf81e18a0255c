// `analyses: { localization: { truth: truth, estimate: estimate, map: stems.csv, after_s: 1 } }`: how far an
// application's estimate of its pose was from the truth (localization_error.h). Every key may be left out;
// `map`, a table of stems (relative to the rig), is drawn in the report.
#pragma once

#include "bench/analysis/localization_error.h"
#include "sensor-hal/channel/registry.h"

namespace rigor {

inline constexpr const char* kLocalization = "localization";

/// Its keys. Throws ConfigError.
[[nodiscard]] LocalizationQuestion localization_question(const ConfigNode& params);
[[nodiscard]] NamedAnalysis localization_analysis();

}  // namespace rigor
