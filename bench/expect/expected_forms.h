// The forms in which outcomes of expectations are written.
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>
#include <vector>

#include "bench/expect/expected.h"

namespace rigor {

/// [{"of", "quantity", "bounds", "holds", "looked_at", "outside", "first_s", "least", "most", "outcome",
/// "text"}]
[[nodiscard]] nlohmann::json to_json(const std::vector<Expected>& all);
/// JUnit's XML: a test case for each, and one that the run itself ended as it was to.
[[nodiscard]] std::string junit_text(const std::vector<Expected>& all, const std::string& rig,
                                     const std::string& failure_of_run, double duration_s);

}  // namespace rigor
