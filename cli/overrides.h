// `--set path.to.key=value`, as often as it was given.
#pragma once

#include <string>
#include <vector>

#include "sensor-hal/config/yaml.h"

namespace rigor {

[[nodiscard]] inline Result<std::vector<ConfigOverride>> parse_overrides(
    const std::vector<std::string>& texts) {
  std::vector<ConfigOverride> overrides;
  for (const std::string& text : texts) {
    auto o = ConfigOverride::parse(text);
    if (!o) return tl::unexpected<Error>(o.error());
    overrides.push_back(std::move(*o));
  }
  return overrides;
}

}  // namespace rigor
