// Attributes and nodes of the world as JSON, and JSON as what an attribute holds.
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>

#include "rt-core/result.h"
#include "sim/world/graph/snapshot.h"

namespace rigor::live {

/// NaN as null; motion and blob as text that says what they are.
[[nodiscard]] nlohmann::json value_json(const world::Value& value);
/// bad_input: not of this kind, or a kind that cannot be written (motion, blob). `where` begins the message.
[[nodiscard]] Result<world::Value> value_from(const nlohmann::json& j, world::ValueKind kind,
                                              const std::string& where);

/// `name` of a node, or empty.
[[nodiscard]] std::string name_of_node(const world::Snapshot& world, world::NodeId node);
[[nodiscard]] std::string type_name_of(const world::Snapshot& world, world::NodeId node);
/// The answer of rigor/world/node. Precondition: the world contains it.
[[nodiscard]] nlohmann::json node_json(const world::Snapshot& world, world::NodeId node);
/// The kind of a node's attribute, own, inherited or dynamic; bad_input with the nearest name.
[[nodiscard]] Result<world::ValueKind> kind_of_attribute(const world::Snapshot& world, world::NodeId node,
                                                         const std::string& attribute);

}  // namespace rigor::live
