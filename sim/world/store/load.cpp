#include "sim/world/store/load.h"

#include <fmt/format.h>

#include <optional>

#include "sim/world/graph/snapshot_state.h"
#include "sim/world/store/tables.h"
#include "sim/world/store/value_codec.h"

namespace rigor::world::store {
namespace {

class Loader {
 public:
  Loader(Sqlite& sql, Transaction& tx, const Schema& schema, const std::string& file)
      : sql_(sql), tx_(tx), schema_(schema), file_(file) {}

  Status nodes(const FileSchema& known) {
    std::int64_t count = 0;
    for (const auto& type : known.types)
      if (!type.abstract)
        if (auto s = nodes_of(known, type, count); !s) return s;
    if (const auto listed = sql_.integer("SELECT count(*) FROM nodes"); sql_.ok() && listed != count)
      return damaged(fmt::format("table nodes has {} nodes, the tables of their types {}", listed, count));
    return sql_.status();
  }

  Status edges() {
    auto rows = sql_.prepare(
        "SELECT e.source, t.name, e.target FROM edges e LEFT JOIN edge_types t ON t.id = e.type "
        "ORDER BY e.type, e.source, e.position");
    while (rows.step()) {
      const auto source = id(rows.integer(0)), target = id(rows.integer(2));
      const auto edge = schema_.find_edge(rows.text(1));
      if (!edge) return damaged(fmt::format("edges of node {}: of a type that the file lacks", source.value));
      if (auto s = tx_.connect(source, *edge, target); !s)
        return damaged(fmt::format("node {}, {} to {}: {}", source.value, rows.text(1), target.value,
                                   s.error().message));
    }
    return sql_.status();
  }

  Status dynamic_attributes() {
    auto rows = sql_.prepare("SELECT node, name, kind, value FROM dynamic_attributes ORDER BY node, name");
    while (rows.step()) {
      const auto kind = kind_named(rows.text(2));
      auto value = kind ? read_cell(rows, 3, *kind) : std::nullopt;
      const auto name = fmt::format("node {}: {}", id(rows.integer(0)).value, rows.text(1));
      if (!value) return damaged(name + ": expected a " + rows.text(2) + ", got a value of another kind");
      if (auto s = tx_.set_dynamic(id(rows.integer(0)), rows.text(1), std::move(*value)); !s)
        return damaged(name + ": " + s.error().message);
    }
    return sql_.status();
  }

 private:
  struct Column {
    std::string name;
    ValueKind kind = ValueKind::flag;
    std::optional<AttributeId> attribute;  ///< empty: transient by now
    Value default_value;
  };

  static NodeId id(std::int64_t number) { return NodeId{static_cast<std::uint64_t>(number)}; }
  [[nodiscard]] Status damaged(const std::string& what) const {
    return fail(ErrorCode::bad_input, file_,
                what + "; mend it with sqlite3, or restore the file from a copy");
  }

  /// Of the type and its bases, as the file has them.
  std::vector<Column> columns(const FileSchema& known, const TypeSpec& type) const {
    std::vector<Column> out;
    const auto here = schema_.require_type(type.name);
    for (const TypeSpec* t = &type; t != nullptr;) {
      for (const auto& a : t->attributes) {
        if (a.transient) continue;
        const auto attribute = schema_.find_attribute(here, a.name);
        const auto& info = schema_.attribute(*attribute);
        out.push_back({a.name, kind_of(a.default_value),
                       info.spec.transient ? std::nullopt : std::optional(*attribute),
                       info.spec.default_value});
      }
      const TypeSpec* base = nullptr;
      for (const auto& other : known.types)
        if (other.name == t->base && &other != t) base = &other;
      t = base;
    }
    return out;
  }

  Status nodes_of(const FileSchema& known, const TypeSpec& type, std::int64_t& count) {
    const auto here = schema_.require_type(type.name);
    const auto wanted = columns(known, type);
    auto where = sql_.prepare("SELECT id, table_name FROM types WHERE name = ?");
    where.bind(0, type.name);
    if (!where.step()) return sql_.status();
    std::string select = "SELECT n.id";
    for (const auto& c : wanted)
      for (const auto& name : column_names(c.name, c.kind)) select += ", t." + name;
    auto rows = sql_.prepare(select + " FROM " + sql_name(where.text(1)) +
                             " t JOIN nodes n ON n.id = t.id AND n.type = ? ORDER BY n.id");
    rows.bind(0, where.integer(0));
    while (rows.step()) {
      const auto node = id(rows.integer(0));
      if (auto s = tx_.create_as(node, here); !s)
        return damaged(fmt::format("node {} ({}): {}", node.value, type.name, s.error().message));
      if (auto s = attributes_of(rows, node, type.name, wanted); !s) return s;
      ++count;
    }
    return sql_.status();
  }

  Status attributes_of(const Statement& row, NodeId node, const std::string& type,
                       const std::vector<Column>& columns) {
    int at = 1;
    for (const auto& c : columns) {
      auto value = read_columns(row, at, c.kind);
      at += static_cast<int>(columns_of(c.kind).size());
      if (!c.attribute) continue;
      const auto name = [&] { return fmt::format("node {} ({}): {}: ", node.value, type, c.name); };
      if (!value)
        return damaged(name() + "expected a " + std::string(name_of(c.kind)) +
                       ", got a value of another kind");
      if (same_value(*value, c.default_value)) continue;
      if (auto s = tx_.set(node, *c.attribute, std::move(*value)); !s)
        return damaged(name() + s.error().message);
    }
    return {};
  }

  Sqlite& sql_;
  Transaction& tx_;
  const Schema& schema_;
  const std::string& file_;
};

}  // namespace

Status skip_ids(Transaction& tx, NodeId next) {
  if (next.value < 2) return {};
  const NodeId last{next.value - 1};
  if (tx.view().state().world.next_id >= next.value) return {};
  if (auto s = tx.create_as(last, TypeId{}); !s) return s;
  return tx.remove(last);
}

Status load(Sqlite& sql, Database& db, const std::filesystem::path& file, DirtyNodes& dirty) {
  const auto where = file.string();
  const FileSchema known = read_schema(sql);
  if (auto s = sql.status(); !s) return s;
  if (auto s = merge_schema(known, db, where); !s) return s;
  auto tx = db.begin("load " + file.filename().string());
  const Schema schema = db.schema();
  Loader loader(sql, tx, schema, where);
  if (auto s = loader.nodes(known); !s) return s;
  if (auto s = loader.edges(); !s) return s;
  if (auto s = loader.dynamic_attributes(); !s) return s;
  const auto next =
      static_cast<std::uint64_t>(sql.integer("SELECT value FROM meta WHERE key = 'next_node_id'"));
  if (auto s = sql.status(); !s) return s;
  if (auto s = skip_ids(tx, NodeId{next}); !s)
    return fail(ErrorCode::bad_input, where, "meta.next_node_id: " + s.error().message);
  const Snapshot loaded = tx.view();
  if (auto s = tx.commit(); !s) return fail(ErrorCode::bad_input, where, s.error().message);
  dirty.note_difference(loaded, db.snapshot());
  db.forget_history();
  return {};
}

}  // namespace rigor::world::store
