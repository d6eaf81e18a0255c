// The forms in which a verdict is written: JSON, and of that lines for a terminal and a box of HTML.
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>

#include "bench/result/verdict.h"

namespace rigor {

/// {"state": "good" | "warning" | "bad", "text": …, "findings": [{"severity", "kinds", "channel", "text",
/// "cure"}]}
[[nodiscard]] nlohmann::json verdict_json(const Verdict& verdict);
/// Of such JSON: lines for a terminal.
[[nodiscard]] std::string verdict_text(const nlohmann::json& verdict);
/// Of such JSON: the box on top of a report. HTML.
[[nodiscard]] std::string verdict_section(const nlohmann::json& verdict);

}  // namespace rigor
