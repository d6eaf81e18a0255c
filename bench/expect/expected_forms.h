// The forms in which outcomes of expectations are written.
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <string>
#include <vector>

#include "bench/expect/expected.h"

namespace rigor {

/// [{"of", "quantity", "bounds", "state", "holds", "looked_at", "outside", "first_s", "minimum", "maximum",
/// "outcome", "text"}]; `holds` is null of what is undecided or unknown.
[[nodiscard]] nlohmann::json to_json(const std::vector<Expected>& all);
/// JUnit's XML: a test case for each, skipped where it is unknown, and one that the run itself ended as it
/// was to: `failure_of_run` is empty where it did, and null where no run is judged.
[[nodiscard]] std::string junit_text(const std::vector<Expected>& all, const std::string& rig,
                                     const std::optional<std::string>& failure_of_run, double duration_s);

}  // namespace rigor
