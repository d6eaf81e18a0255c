// The result of a calibration as JSON, as text, and as a page of HTML. Pure: nothing is read or written.
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>

#include "calibration/procedures/calibration_result.h"

namespace rigor {

/// All numbers: those of the fit (calibration/core/fit_output.h), the details beside them, and `notes`.
[[nodiscard]] nlohmann::json result_json(const CalibrationResult& result);
/// For people: parameters with as many digits as their sigma leaves meaning to, models compared, warnings.
[[nodiscard]] std::string text_report(const CalibrationResult& result);
/// A page with tables and figures that needs no other file.
[[nodiscard]] std::string html_report(const CalibrationResult& result);

}  // namespace rigor
