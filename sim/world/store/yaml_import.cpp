#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <limits>
#include <optional>

#include "sensor-hal/config/yaml.h"
#include "sim/world/store/file_schema.h"
#include "sim/world/store/load.h"
#include "sim/world/store/value_codec.h"
#include "sim/world/store/world_file.h"

namespace rigor::world {
namespace {

constexpr double kInf = std::numeric_limits<double>::infinity();

/// As ConfigNode's numbers, and those that are not finite.
// What a world holds comes back whatever it is: no limit by unit.
constexpr Range kAny{.min = std::numeric_limits<double>::lowest(), .max = std::numeric_limits<double>::max()};

double real(const ConfigNode& n) {
  const auto word = n.as_text();
  if (word == ".nan") return std::numeric_limits<double>::quiet_NaN();
  if (word == ".inf") return kInf;
  if (word == "-.inf") return -kInf;
  return n.as_number(kAny);
}

double real(const ConfigNode& n, std::string_view key) {
  const auto word = n.text(key);
  if (word == ".nan") return std::numeric_limits<double>::quiet_NaN();
  if (word == ".inf") return kInf;
  if (word == "-.inf") return -kInf;
  return n.number(key, kAny);
}

std::vector<double> reals(const ConfigNode& n, std::string_view key, std::optional<std::size_t> count) {
  const auto items = n.list(key);
  if (count && items.size() != *count)
    throw n.error(key, fmt::format("expected a list of {} numbers, got one of {}", *count, items.size()));
  std::vector<double> out;
  out.reserve(items.size());
  for (const auto& i : items) out.push_back(real(i));
  return out;
}

std::vector<std::byte> bytes(const ConfigNode& n, std::string_view key) {
  auto b = store::from_base64(n.text(key));
  if (!b) throw n.error(key, "expected base64, got other text");
  return std::move(*b);
}

std::string text_of(const std::vector<std::byte>& b) {
  return {reinterpret_cast<const char*>(b.data()), b.size()};
}

/// An id: 1 to 2^64 − 1.
NodeId id(const std::string& word, const ConfigNode& n, std::string_view key) {
  NodeId out;
  const auto [end, ec] = std::from_chars(word.data(), word.data() + word.size(), out.value);
  if (ec != std::errc{} || end != word.data() + word.size() || !out)
    throw n.error(key, "expected a node's id (1, 2, …), got '" + word + "'");
  return out;
}

Value value(const ConfigNode& n, std::string_view key, ValueKind kind) {
  switch (kind) {
    case ValueKind::flag:
      return n.flag(key);
    case ValueKind::integer:
      return n.integer(key);
    case ValueKind::number:
      return real(n, key);
    case ValueKind::text:
      return n.text(key);
    case ValueKind::vector3:
      return store::vector3_of(reals(n, key, 3));
    case ValueKind::pose:
      return store::pose_of(reals(n, key, 12));
    case ValueKind::motion: {
      const auto m = n.map(key);
      const auto state = reals(m, "state", 18);
      const BenchTime t(m.integer("t_ref_ns"));
      m.finish();
      return store::motion_of(t, state);
    }
    case ValueKind::numbers:
      return Numbers(reals(n, key, std::nullopt));
    case ValueKind::blob:
      return Blob(bytes(n, key));
  }
  throw n.error(key, "expected a value of a known kind");
}

/// `key`, or the same as `key_base64` for text that is no UTF-8.
Value value_or_base64(const ConfigNode& n, const std::string& key, ValueKind kind) {
  if (kind == ValueKind::text && n.has(key + "_base64")) return text_of(bytes(n, key + "_base64"));
  return value(n, key, kind);
}

ValueKind read_kind(const ConfigNode& n) {
  std::vector<std::string> words;
  for (std::size_t k = 0; k < std::variant_size_v<Value>; ++k)
    words.emplace_back(name_of(static_cast<ValueKind>(k)));
  return *store::kind_named(n.choice("kind", words));
}

store::FileSchema read_schema(const ConfigNode& root) {
  store::FileSchema out;
  for (const auto& n : root.list_or_empty("types")) {
    TypeSpec t{.name = n.text("name"),
               .base = n.text_or("base", ""),
               .abstract = n.flag_or("abstract", false),
               .meaning = n.text_or("meaning", ""),
               .place_attribute = n.text_or("place_attribute", "")};
    for (const auto& a : n.list_or_empty("attributes")) {
      AttributeSpec spec{.name = a.text("name"),
                         .default_value = value_or_base64(a, "default", read_kind(a)),
                         .unit = a.text_or("unit", ""),
                         .meaning = a.text_or("meaning", ""),
                         .transient = a.flag_or("transient", false),
                         .min = a.number_or("min", -kInf),
                         .max = a.number_or("max", kInf),
                         .nan_is_unknown = a.flag_or("nan_is_unknown", false)};
      for (const auto& c : a.list_or_empty("choices")) spec.choices.push_back(c.as_text());
      a.finish();
      t.attributes.push_back(std::move(spec));
    }
    n.finish();
    out.types.push_back(std::move(t));
  }
  const auto cardinality = [](const ConfigNode& n, std::string_view key) {
    return n.choice_or(key, {"one", "many"}, "many") == "one" ? Cardinality::one : Cardinality::many;
  };
  for (const auto& n : root.list_or_empty("edges")) {
    out.edges.push_back({.name = n.text("name"),
                         .from = n.text_or("from", "Object"),
                         .to = n.text_or("to", "Object"),
                         .targets_per_source = cardinality(n, "targets_per_source"),
                         .sources_per_target = cardinality(n, "sources_per_target"),
                         .acyclic = n.flag_or("acyclic", false),
                         .removes_sources = n.flag_or("removes_sources", false),
                         .meaning = n.text_or("meaning", "")});
    n.finish();
  }
  return out;
}

class Reader {
 public:
  Reader(Transaction& tx, const Schema& schema, const std::vector<TypeSpec>& file)
      : tx_(tx), schema_(schema), file_(file) {}

  void node(const ConfigNode& n) {
    const auto node = id(n.text("id"), n, "id");
    const auto name = n.text("type");
    const auto type = schema_.find_type(name);
    if (!type) throw n.error("type", "expected a type of this world, got '" + name + "'" + near_type(name));
    check(tx_.create_as(node, *type), n, "id");
    // Where the file's default is not the database's, a value that the file leaves out is the file's.
    for (auto t = std::optional(*type);; t = schema_.base(*t)) {
      for (const auto& spec : file_)
        if (spec.name == schema_.type(*t).name) set_defaults(node, *type, spec, n);
      if (*t == TypeId{}) break;
    }
    attributes(n.map_or_absent("attributes"), node, *type, false);
    attributes(n.map_or_absent("attributes_base64"), node, *type, true);
    for (const auto& d : n.list_or_empty("dynamic")) {
      const auto own = d.has("name_base64") ? text_of(bytes(d, "name_base64")) : d.text("name");
      check(tx_.set_dynamic(node, own, value_or_base64(d, "value", read_kind(d))), d, "name");
      d.finish();
    }
  }

  /// When every node is there.
  void edges(const ConfigNode& n) {
    const auto node = id(n.text("id"), n, "id");
    const auto map = n.map_or_absent("edges");
    for (const auto& key : map.keys()) {
      const auto edge = schema_.find_edge(key);
      if (!edge) throw map.error(key, "expected an edge of this world, got '" + key + "'");
      for (const auto& target : map.list(key))
        check(tx_.connect(node, *edge, id(target.as_text(), target, {})), target, {});
    }
  }

 private:
  static void check(const Status& s, const ConfigNode& n, std::string_view key) {
    if (!s) throw n.error(key, s.error().message);
  }

  [[nodiscard]] std::string near_type(const std::string& name) const {
    std::vector<std::string> names;
    for (std::uint32_t t = 0; t < schema_.type_count(); ++t) names.push_back(schema_.type(TypeId{t}).name);
    const auto near = nearest(name, names);
    return near.empty() ? "; load the plugin that defines it" : "; did you mean " + near + "?";
  }

  void set_defaults(NodeId node, TypeId type, const TypeSpec& spec, const ConfigNode& n) {
    for (const auto& a : spec.attributes) {
      const auto here = schema_.find_attribute(type, a.name);
      const auto& known = schema_.attribute(*here).spec;
      if (!known.transient && !a.transient && !same_value(known.default_value, a.default_value))
        check(tx_.set(node, *here, a.default_value), n, "type");
    }
  }

  void attributes(const ConfigNode& map, NodeId node, TypeId type, bool raw) {
    for (const auto& key : map.keys()) {
      const auto a = schema_.find_attribute(type, key);
      if (!a) {
        std::vector<std::string> names;
        for (const auto other : schema_.attributes(type)) names.push_back(schema_.attribute(other).spec.name);
        const auto near = nearest(key, names);
        throw map.error(key, "expected an attribute of " + schema_.type(type).name +
                                 (near.empty() ? "" : "; did you mean " + near + "?"));
      }
      const auto kind = schema_.attribute(*a).kind();
      if (raw && kind != ValueKind::text) throw map.error(key, "expected an attribute that holds text");
      check(tx_.set(node, *a, raw ? Value(text_of(bytes(map, key))) : value(map, key, kind)), map, key);
    }
  }

  Transaction& tx_;
  const Schema& schema_;
  const std::vector<TypeSpec>& file_;
};

}  // namespace

Status import_world_yaml(const std::filesystem::path& file, Database& db) {
  if (db.snapshot().node_count() != 0)
    return fail(ErrorCode::wrong_state, file.string(), "expected a database without nodes to import into");
  auto root = ConfigDocument::load(file);
  if (!root) return tl::unexpected<Error>(root.error());
  auto read = catch_config([&]() -> Status {
    const auto& n = *root;
    if (n.integer("rigor_world") != 1)
      throw n.error("rigor_world", "expected 1, the version of this format that this Rigor reads");
    const auto schema = read_schema(n);
    const auto next = id(n.text_or("next_id", "1"), n, "next_id");
    const auto nodes = n.list("nodes");
    // Read by whoever opens the world: plugins are loaded before it is read (docs/world-plugins.md).
    for (const char* key : {"plugins", "plugin_files"}) (void)n.list_or_empty(key);
    n.finish();
    if (auto s = store::merge_schema(schema, db, file.string()); !s) return s;
    auto tx = db.begin("import " + file.filename().string());
    const Schema known = db.schema();
    Reader reader(tx, known, schema.types);
    for (const auto& node : nodes) reader.node(node);
    for (const auto& node : nodes) {
      reader.edges(node);
      node.finish();
    }
    if (auto s = store::skip_ids(tx, next); !s) throw n.error("next_id", s.error().message);
    if (auto s = tx.commit(); !s) return fail(ErrorCode::bad_input, file.string(), s.error().message);
    return {};
  });
  if (!read) return tl::unexpected<Error>(read.error());
  return *read;
}

}  // namespace rigor::world
