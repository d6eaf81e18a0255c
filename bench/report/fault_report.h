// The faults of a run in its report: when each was on, beside what the ports showed, and what it touched.
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>

namespace rigor {

/// HTML; empty where the run had no faults.
[[nodiscard]] std::string faults_section(const nlohmann::json& result);

}  // namespace rigor
