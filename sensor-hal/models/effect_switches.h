// Effects of a sensor model by name, each of which can be taken away: what `--only EFFECT,…` is made of.
#pragma once

#include <algorithm>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "rt-core/result.h"

namespace rigor::models {

template <class Model>
struct EffectSwitch {
  std::string_view name;
  void (*off)(Model&);
};

/// The model with every effect of the list off but those named; "none" names none. bad_input: a name that
/// there is not, with all that there are.
template <class Model>
[[nodiscard]] Result<Model> only_effects_of(std::span<const EffectSwitch<Model>> switches, Model model,
                                            std::span<const std::string> names) {
  std::string known;
  for (const auto& s : switches) known += (known.empty() ? "" : ", ") + std::string(s.name);
  for (const std::string& name : names)
    if (name != "none" &&
        std::none_of(switches.begin(), switches.end(), [&](const auto& s) { return s.name == name; }))
      return fail(ErrorCode::bad_input, "--only",
                  "expected effects of this sensor (" + known + ") or none, got \"" + name + "\"");
  for (const auto& s : switches)
    if (std::find(names.begin(), names.end(), s.name) == names.end()) s.off(model);
  return model;
}

}  // namespace rigor::models
