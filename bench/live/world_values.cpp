#include "bench/live/world_values.h"

#include <fmt/format.h>

#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>

#include "sensor-hal/config/yaml.h"
#include "sim/world/pose.h"
#include "sim/world/semantic_types.h"

namespace rigor::live {
namespace {

using nlohmann::json;
using world::ValueKind;

json vector_json(const world::Vector3& v) { return {v.x(), v.y(), v.z()}; }

json pose_json(const world::Pose& T) {
  const Pose pose = pose_of(T);
  return {{"position_m", pose.position_m}, {"quaternion_wxyz", pose.orientation_wxyz}};
}

struct ToJson {
  json operator()(bool v) const { return v; }
  json operator()(std::int64_t v) const { return v; }
  json operator()(double v) const { return v; }
  json operator()(const std::string& v) const { return v; }
  json operator()(const world::Vector3& v) const { return vector_json(v); }
  json operator()(const world::Pose& v) const { return pose_json(v); }
  json operator()(const world::Motion& v) const {
    const world::Vector3 p = v.T_parent_node.translation();
    return fmt::format("at {:.3f}, {:.3f}, {:.3f} m, {:.3f} m/s, {:.3f} rad/s", p.x(), p.y(), p.z(),
                       v.velocity_m_per_s.norm(), v.angular_velocity_rad_per_s.norm());
  }
  json operator()(const world::Numbers& v) const {
    json list = json::array();
    for (const double x : v.span()) list.push_back(x);
    return list;
  }
  json operator()(const world::Blob& v) const { return fmt::format("{} bytes", v.size()); }
};

/// A number, or null for NaN.
std::optional<double> number(const json& j) {
  if (j.is_null()) return std::numeric_limits<double>::quiet_NaN();
  return j.is_number() ? std::optional(j.get<double>()) : std::nullopt;
}

std::optional<std::vector<double>> numbers(const json& j, std::size_t count) {
  constexpr std::size_t kMost = 100'000;
  if (!j.is_array() || (count > 0 && j.size() != count) || j.size() > kMost) return {};
  std::vector<double> v;
  for (const json& e : j) {
    const auto x = number(e);
    if (!x) return {};
    v.push_back(*x);
  }
  return v;
}

std::optional<world::Pose> pose(const json& j) {
  if (!j.is_object() || !j.contains("position_m") || !j.contains("quaternion_wxyz")) return {};
  const auto p = numbers(j["position_m"], 3), q = numbers(j["quaternion_wxyz"], 4);
  if (!p || !q) return {};
  for (const double x : *p)
    if (!std::isfinite(x)) return {};
  const Eigen::Quaterniond rotation((*q)[0], (*q)[1], (*q)[2], (*q)[3]);
  if (!(std::abs(rotation.norm() - 1) < 1e-3)) return {};
  world::Pose out = world::Pose::Identity();
  out.linear() = rotation.normalized().toRotationMatrix();
  out.translation() = world::Vector3((*p)[0], (*p)[1], (*p)[2]);
  return out;
}

const char* expected(ValueKind kind) {
  switch (kind) {
    case ValueKind::flag:
      return "true or false";
    case ValueKind::integer:
      return "a whole number";
    case ValueKind::number:
      return "a number, or null for NaN";
    case ValueKind::text:
      return "text";
    case ValueKind::vector3:
      return "a list of three numbers";
    case ValueKind::pose:
      return "an object with position_m (three numbers) and quaternion_wxyz (four, of length 1)";
    case ValueKind::numbers:
      return "a list of numbers";
    case ValueKind::motion:
    case ValueKind::blob:
      break;
  }
  return "an attribute that can be written; motions and blobs cannot";
}

std::optional<world::Value> value_of(const json& j, ValueKind kind) {
  switch (kind) {
    case ValueKind::flag:
      return j.is_boolean() ? std::optional<world::Value>(j.get<bool>()) : std::nullopt;
    case ValueKind::integer: {
      if (j.is_number_unsigned() && j.get<std::uint64_t>() > std::uint64_t{1} << 62) return {};
      if (j.is_number_integer()) return world::Value(j.get<std::int64_t>());
      return {};
    }
    case ValueKind::number:
      if (const auto x = number(j)) return world::Value(*x);
      return {};
    case ValueKind::text:
      return j.is_string() ? std::optional<world::Value>(j.get<std::string>()) : std::nullopt;
    case ValueKind::vector3:
      if (const auto v = numbers(j, 3)) return world::Value(world::Vector3((*v)[0], (*v)[1], (*v)[2]));
      return {};
    case ValueKind::pose:
      if (const auto p = pose(j)) return world::Value(*p);
      return {};
    case ValueKind::numbers:
      if (auto v = numbers(j, 0)) return world::Value(world::Numbers(std::move(*v)));
      return {};
    case ValueKind::motion:
    case ValueKind::blob:
      return {};
  }
  return {};
}

bool writable(ValueKind kind) { return kind != ValueKind::motion && kind != ValueKind::blob; }

json limit(double v) { return std::isfinite(v) ? json(v) : json(); }

}  // namespace

json value_json(const world::Value& value) { return std::visit(ToJson{}, value); }

Result<world::Value> value_from(const json& j, ValueKind kind, const std::string& where) {
  if (auto v = value_of(j, kind)) return std::move(*v);
  return fail(ErrorCode::bad_input, where,
              fmt::format("expected {}, got {}", expected(kind),
                          j.dump(-1, ' ', false, json::error_handler_t::replace).substr(0, 200)));
}

std::string name_of_node(const world::Snapshot& world, world::NodeId node) {
  const auto name = world.get(node, "name");
  const auto* text = name ? std::get_if<std::string>(&*name) : nullptr;
  return text ? *text : std::string();
}

std::string type_name_of(const world::Snapshot& world, world::NodeId node) {
  const auto type = world.type_of(node);
  return type ? world.schema().type(*type).name : std::string();
}

json node_json(const world::Snapshot& world, world::NodeId node) {
  const world::Schema& schema = world.schema();
  const world::TypeId type = *world.type_of(node);
  json j{{"id", node.value},
         {"type", schema.type(type).name},
         {"types", json::array()},
         {"meaning", schema.type(type).meaning},
         {"name", name_of_node(world, node)},
         {"attributes", json::array()},
         {"relations", json::array()}};
  for (world::TypeId t = type;; t = schema.base(t)) {
    j["types"].push_back(schema.type(t).name);
    if (t.value == 0) break;
  }
  for (const world::AttributeId a : schema.attributes(type)) {
    const world::AttributeInfo& info = schema.attribute(a);
    const auto value = world.get(node, a);
    if (!value) continue;
    j["attributes"].push_back({{"name", info.spec.name},
                               {"kind", world::name_of(info.kind())},
                               {"value", value_json(*value)},
                               {"unit", info.spec.unit},
                               {"meaning", info.spec.meaning},
                               {"of", schema.type(info.owner).name},
                               {"min", limit(info.spec.min)},
                               {"max", limit(info.spec.max)},
                               {"choices", info.spec.choices},
                               {"transient", info.spec.transient},
                               {"dynamic", false},
                               {"writable", writable(info.kind())}});
  }
  for (const auto& [name, value] : world.dynamic_attributes(node))
    j["attributes"].push_back({{"name", name},
                               {"kind", world::name_of(world::kind_of(value))},
                               {"value", value_json(value)},
                               {"unit", ""},
                               {"meaning", ""},
                               {"of", ""},
                               {"min", nullptr},
                               {"max", nullptr},
                               {"choices", json::array()},
                               {"transient", false},
                               {"dynamic", true},
                               {"writable", writable(world::kind_of(value))}});
  constexpr std::size_t kMostRelations = 500;
  const auto relate = [&](world::EdgeTypeId edge, const char* side, world::NodeId other) {
    if (j["relations"].size() < kMostRelations)
      j["relations"].push_back({{"edge", schema.edge(edge).name},
                                {side, other.value},
                                {"type", type_name_of(world, other)},
                                {"name", name_of_node(world, other)}});
  };
  for (std::uint32_t e = 0; e < schema.edge_type_count(); ++e) {
    for (const world::NodeId to : world.targets(node, {e})) relate({e}, "to", to);
    for (const world::NodeId from : world.sources(node, {e})) relate({e}, "from", from);
  }
  return j;
}

Result<ValueKind> kind_of_attribute(const world::Snapshot& world, world::NodeId node,
                                    const std::string& attribute) {
  const world::Schema& schema = world.schema();
  const auto type = world.type_of(node);
  if (!type) return fail(ErrorCode::not_found, "id", fmt::format("there is no node {}", node.value));
  if (const auto a = schema.find_attribute(*type, attribute)) return schema.attribute(*a).kind();
  std::vector<std::string> names;
  for (const world::AttributeId a : schema.attributes(*type)) names.push_back(schema.attribute(a).spec.name);
  for (const auto& [name, value] : world.dynamic_attributes(node)) {
    if (name == attribute) return world::kind_of(value);
    names.push_back(name);
  }
  const std::string near = nearest(attribute, names);
  return fail(ErrorCode::bad_input, "attribute",
              fmt::format("expected an attribute of {}, got \"{}\"{}", schema.type(*type).name, attribute,
                          near.empty() ? "" : "; did you mean " + near + "?"));
}

}  // namespace rigor::live
