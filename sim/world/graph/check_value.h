// Whether a value keeps within what its attribute allows.
#pragma once

#include <optional>
#include <string>

#include "sim/world/graph/schema.h"

namespace rigor::world {

/// What is wrong with `value`, an object of the kind of the spec's default; empty where nothing is.
[[nodiscard]] std::optional<std::string> check_value(const AttributeSpec& spec, const void* value);

/// The object within a Value.
[[nodiscard]] inline const void* address_of(const Value& v) {
  return std::visit([](const auto& x) -> const void* { return &x; }, v);
}
[[nodiscard]] inline void* address_of(Value& v) {
  return std::visit([](auto& x) -> void* { return &x; }, v);
}

}  // namespace rigor::world
