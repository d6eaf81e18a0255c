// What a report shows of a pair that is watched: the sentence, the windowed statistics, each parameter over
// time.
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>

namespace rigor {

/// `watch`: as pair_json writes it, with its series; `unit` of the differences. HTML.
[[nodiscard]] std::string pair_watch_card(const std::string& channel, const nlohmann::json& watch,
                                          const std::string& unit);

}  // namespace rigor
