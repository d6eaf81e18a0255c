// Measured latencies as JSON and as text.
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>

#include "calibration/procedures/latency_calibration.h"

namespace rigor {

/// All numbers in milliseconds, with the inputs and their SHA-256, which reads those files. `options` are
/// those that the result was made with.
[[nodiscard]] nlohmann::json latency_json(const LatencyCalibrationOptions& options,
                                          const LatencyCalibration& result);
/// For people: a table of the channels, the latency_ms to put into the rig, warnings.
[[nodiscard]] std::string latency_text(const LatencyCalibrationOptions& options,
                                       const LatencyCalibration& result);

}  // namespace rigor
