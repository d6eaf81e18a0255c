// The end of a message about a word that is not on the list.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "sensor-hal/config/renamed.h"
#include "sensor-hal/config/yaml.h"

namespace rigor {

/// "; did you mean left?", "; now called log", or nothing where no candidate is near.
[[nodiscard]] inline std::string did_you_mean(std::string_view word,
                                              const std::vector<std::string>& candidates) {
  if (const std::string now = renamed(word, candidates); !now.empty()) return "; now called " + now;
  const std::string near = nearest(word, candidates);
  return near.empty() ? near : "; did you mean " + near + "?";
}

}  // namespace rigor
