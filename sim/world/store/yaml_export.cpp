// A world as YAML. The bytes are a function of the world alone: types in the order of their definition, nodes
// by id, attributes in the order of their type, doubles by the shortest text that reads as the same double.
#include <fmt/format.h>

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <cmath>
#include <cstring>
#include <fstream>

#include "sim/world/graph/snapshot_state.h"
#include "sim/world/store/file_schema.h"
#include "sim/world/store/utf8.h"
#include "sim/world/store/value_codec.h"
#include "sim/world/store/world_file.h"

namespace rigor::world {
namespace {

std::string number(double x) {
  if (std::isnan(x)) return ".nan";
  if (std::isinf(x)) return x > 0 ? ".inf" : "-.inf";
  char text[32];
  const auto end = std::to_chars(text, text + sizeof text, x).ptr;
  return {text, end};
}

std::string list(std::span<const double> values) {
  std::string s = "[";
  for (std::size_t i = 0; i < values.size(); ++i) s += (i ? ", " : "") + number(values[i]);
  return s + "]";
}

std::string boolean(bool b) { return b ? "true" : "false"; }

/// In quotes, always: what is text stays text.
std::string text(std::string_view s) {
  std::string out = "\"";
  while (!s.empty()) {
    const auto c = store::first_character(s);
    if (c.bytes == 0) {  // only where a plugin's own texts are broken
      out += "\\ufffd";
      s.remove_prefix(1);
      continue;
    }
    const auto bytes = s.substr(0, c.bytes);
    s.remove_prefix(c.bytes);
    if (bytes == "\"" || bytes == "\\")
      out += fmt::format("\\{}", bytes);
    else if (bytes == "\n")
      out += "\\n";
    else if (bytes == "\t")
      out += "\\t";
    else if (c.code < 0x20 || c.code == 0x7F)
      out += fmt::format("\\x{:02x}", c.code);
    else if ((c.code >= 0x80 && c.code <= 0xA0) || c.code == 0x2028 || c.code == 0x2029 || c.code == 0xFEFF)
      out += fmt::format("\\u{:04x}", c.code);  // breaks of lines and marks of order, which parsers differ on
    else
      out += bytes;
  }
  return out + '"';
}

/// Text that is no UTF-8 goes as base64, into a map of its own.
bool is_plain(const Value& v) {
  const auto* s = std::get_if<std::string>(&v);
  return s == nullptr || store::is_utf8(*s);
}

std::string scalar(const Value& v) {
  switch (kind_of(v)) {
    case ValueKind::flag:
      return boolean(std::get<bool>(v));
    case ValueKind::integer:
      return fmt::format("{}", std::get<std::int64_t>(v));
    case ValueKind::number:
      return number(std::get<double>(v));
    case ValueKind::text:
      return is_plain(v) ? text(std::get<std::string>(v))
                         : text(store::base64(std::as_bytes(std::span(std::get<std::string>(v)))));
    case ValueKind::vector3:
    case ValueKind::pose:
      return list(store::reals_of(v));
    case ValueKind::motion:
      return fmt::format("{{t_ref_ns: {}, state: {}}}", std::get<Motion>(v).t_ref.ns(),
                         list(store::reals_of(v)));
    case ValueKind::numbers:
      return list(std::get<Numbers>(v).span());
    case ValueKind::blob:
      return text(store::base64(std::get<Blob>(v).span()));
  }
  return "";
}

class Writer {
 public:
  explicit Writer(const Snapshot& world) : world_(world), schema_(world.schema()) {}

  std::string write() {
    const auto used = store::used_schema(world_);
    out_ =
        "# A Rigor world: types with what they define, then nodes by id with what differs from the "
        "defaults.\n";
    out_ += fmt::format("rigor_world: 1\nnext_id: {}\n", world_.state().world.next_id);
    out_ += used.types.empty() ? "types: []\n" : "types:\n";
    for (const auto& t : used.types) type(t);
    out_ += used.edges.empty() ? "edges: []\n" : "edges:\n";
    for (const auto& e : used.edges) edge(e);
    auto nodes = world_.nodes(TypeId{});
    std::sort(nodes.begin(), nodes.end());
    out_ += nodes.empty() ? "nodes: []\n" : "nodes:\n";
    for (const auto n : nodes) node(n);
    return std::move(out_);
  }

 private:
  void type(const TypeSpec& t) {
    out_ += fmt::format("  - name: {}\n", text(t.name));
    if (!t.base.empty()) out_ += fmt::format("    base: {}\n", text(t.base));
    if (t.abstract) out_ += "    abstract: true\n";
    if (!t.place_attribute.empty()) out_ += fmt::format("    place_attribute: {}\n", text(t.place_attribute));
    if (!t.meaning.empty()) out_ += fmt::format("    meaning: {}\n", text(t.meaning));
    if (!t.attributes.empty()) out_ += "    attributes:\n";
    for (const auto& a : t.attributes) {
      out_ += fmt::format("      - name: {}\n        kind: {}\n", text(a.name),
                          name_of(kind_of(a.default_value)));
      if (is_plain(a.default_value))
        out_ += fmt::format("        default: {}\n", scalar(a.default_value));
      else
        out_ += fmt::format("        default_base64: {}\n", scalar(a.default_value));
      if (!a.unit.empty()) out_ += fmt::format("        unit: {}\n", text(a.unit));
      if (!a.meaning.empty()) out_ += fmt::format("        meaning: {}\n", text(a.meaning));
      if (a.transient) out_ += "        transient: true\n";
      if (!std::isinf(a.min)) out_ += fmt::format("        min: {}\n", number(a.min));
      if (!std::isinf(a.max)) out_ += fmt::format("        max: {}\n", number(a.max));
      if (a.nan_is_unknown) out_ += "        nan_is_unknown: true\n";
      if (!a.choices.empty()) {
        std::string words;
        for (const auto& c : a.choices) words += (words.empty() ? "" : ", ") + text(c);
        out_ += fmt::format("        choices: [{}]\n", words);
      }
    }
  }

  void edge(const EdgeSpec& e) {
    const auto count = [](Cardinality c) { return c == Cardinality::one ? "one" : "many"; };
    out_ += fmt::format("  - name: {}\n    from: {}\n    to: {}\n", text(e.name), text(e.from), text(e.to));
    out_ += fmt::format("    targets_per_source: {}\n    sources_per_target: {}\n",
                        count(e.targets_per_source), count(e.sources_per_target));
    if (e.acyclic) out_ += "    acyclic: true\n";
    if (e.removes_sources) out_ += "    removes_sources: true\n";
    if (!e.meaning.empty()) out_ += fmt::format("    meaning: {}\n", text(e.meaning));
  }

  void node(NodeId n) {
    const auto type = *world_.type_of(n);
    out_ += fmt::format("  - id: {}\n    type: {}\n", n.value, text(schema_.type(type).name));
    std::vector<std::pair<std::string, Value>> plain, raw;
    for (const auto a : schema_.attributes(type)) {
      const auto& spec = schema_.attribute(a).spec;
      if (spec.transient) continue;
      const Value value = *world_.get(n, a);
      if (!same_value(value, spec.default_value))
        (is_plain(value) ? plain : raw).emplace_back(spec.name, value);
    }
    map("    attributes:\n", plain);
    map("    attributes_base64:\n", raw);
    if (const auto own = world_.dynamic_attributes(n); !own.empty()) {
      out_ += "    dynamic:\n";
      for (const auto& [name, value] : own)
        out_ += fmt::format(
            "      - {{{}: {}, kind: {}, {}: {}}}\n", store::is_utf8(name) ? "name" : "name_base64",
            scalar(name), name_of(kind_of(value)), is_plain(value) ? "value" : "value_base64", scalar(value));
    }
    bool any = false;
    for (std::uint32_t e = 0; e < schema_.edge_type_count(); ++e) {
      const auto targets = world_.targets(n, EdgeTypeId{e});
      if (targets.empty()) continue;
      if (!std::exchange(any, true)) out_ += "    edges:\n";
      std::string ids;
      for (const auto t : targets) ids += fmt::format("{}{}", ids.empty() ? "" : ", ", t.value);
      out_ += fmt::format("      {}: [{}]\n", text(schema_.edge(EdgeTypeId{e}).name), ids);
    }
  }

  void map(const char* head, const std::vector<std::pair<std::string, Value>>& values) {
    if (!values.empty()) out_ += head;
    for (const auto& [name, value] : values) out_ += fmt::format("      {}: {}\n", text(name), scalar(value));
  }

  const Snapshot& world_;
  const Schema& schema_;
  std::string out_;
};

}  // namespace

std::string world_yaml(const Snapshot& world) { return Writer(world).write(); }

Status export_world_yaml(const Snapshot& world, const std::filesystem::path& file) {
  const auto yaml = world_yaml(world);
  // Beside the file, then in its place: a failure leaves what was there.
  auto part = file;
  part += ".part";
  const auto failed = [&](bool opening) {
    const int why = errno;
    std::error_code ec;
    if (!opening) std::filesystem::remove(part, ec);
    if (why == ENOSPC || why == EDQUOT)
      return fail(ErrorCode::disk_full, file.string(),
                  "no space is left for the world; make room and try again");
    return fail(opening ? ErrorCode::not_writable : ErrorCode::io, file.string(),
                std::string("the world cannot be written: ") + std::strerror(why ? why : EIO) +
                    "; check the folder and its rights");
  };
  std::error_code ec;
  if (std::filesystem::is_directory(file, ec))
    return fail(ErrorCode::not_writable, file.string(),
                "expected a file to write, got a folder; name a file in it");
  errno = 0;
  std::ofstream out(part, std::ios::binary | std::ios::trunc);
  if (!out) return failed(true);
  out.write(yaml.data(), static_cast<std::streamsize>(yaml.size()));
  out.close();
  if (!out) return failed(false);
  std::filesystem::rename(part, file, ec);
  if (ec) {
    errno = ec.value();
    return failed(false);
  }
  return {};
}

}  // namespace rigor::world
