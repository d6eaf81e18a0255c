// `analyses: { localization: { truth: truth, estimate: estimate, map: stems.csv, after_s: 1 } }`: how far an
// application's estimate of its pose was from the truth (localization_error.h). `truth` is a channel
// and `estimate` a sink. Optional: `map`, a table of stems (relative to the rig) that is drawn in the report;
// `after_s`.
#pragma once

#include <filesystem>
#include <functional>
#include <vector>

#include "bench/analysis/localization_error.h"
#include "sensor-hal/channel/registry.h"

namespace rigor {

inline constexpr const char* kLocalization = "localization";

/// Its keys. Throws ConfigError.
[[nodiscard]] LocalizationQuestion localization_question(const ConfigNode& params);
/// Reads the table that `map` names.
using StemReader = std::function<Result<std::vector<DrawnStem>>(const std::filesystem::path& file)>;
[[nodiscard]] NamedAnalysis localization_analysis(StemReader read_stems);

}  // namespace rigor
