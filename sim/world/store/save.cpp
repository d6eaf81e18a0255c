#include "sim/world/store/save.h"

#include <map>
#include <utility>

#include "sim/world/store/value_codec.h"

namespace rigor::world::store {
namespace {

std::int64_t number(NodeId node) { return static_cast<std::int64_t>(node.value); }

class Saver {
 public:
  Saver(Sqlite& sql, const FileNumbers& numbers, const Snapshot& world)
      : sql_(sql),
        numbers_(numbers),
        world_(world),
        table_of_(
            sql.prepare("SELECT t.table_name FROM nodes n JOIN types t ON t.id = n.type WHERE n.id = ?")),
        forget_node_(sql.prepare("DELETE FROM nodes WHERE id = ?")),
        forget_edges_(sql.prepare("DELETE FROM edges WHERE source = ?")),
        forget_edges_to_(sql.prepare("DELETE FROM edges WHERE target = ?")),
        forget_dynamic_(sql.prepare("DELETE FROM dynamic_attributes WHERE node = ?")),
        write_node_(sql.prepare("INSERT INTO nodes VALUES(?, ?)")),
        write_dynamic_(sql.prepare("INSERT INTO dynamic_attributes VALUES(?, ?, ?, ?)")),
        forget_edges_of_type_(sql.prepare("DELETE FROM edges WHERE source = ? AND type = ?")),
        write_edge_(sql.prepare("INSERT INTO edges VALUES(?, ?, ?, ?)")) {}

  void save(const DirtyNodes& dirty) {
    // First all that goes, then all that comes: a node may have gone whose id was some other's target.
    std::map<NodeId, std::set<EdgeTypeId>> edges;
    for (const auto& [node, d] : dirty.nodes()) {
      if (!d.whole) continue;
      if (forget(node) && world_.contains(node))
        each_edge([&](EdgeTypeId e) {
          for (const auto source : world_.sources(node, e)) edges[source].insert(e);
        });
    }
    for (const auto& [node, d] : dirty.nodes()) {
      if (!sql_.ok()) return;
      const auto type = world_.type_of(node);
      if (!type) continue;
      if (d.whole) {
        write(node, *type);
        each_edge([&](EdgeTypeId e) {
          if (!world_.targets(node, e).empty()) edges[node].insert(e);
        });
      } else {
        for (const auto a : d.attributes) update(node, *type, a);
        edges[node].insert(d.edges.begin(), d.edges.end());
      }
      if (d.whole || d.dynamic) write_dynamic(node);
    }
    for (const auto& [node, types] : edges)
      for (const auto e : types) write_edges(node, e);
  }

 private:
  template <class F>
  void each_edge(F&& visit) {
    for (std::uint32_t e = 0; e < numbers_.edges.size(); ++e) visit(EdgeTypeId{e});
  }

  /// True where the file had the node.
  bool forget(NodeId node) {
    table_of_.bind(0, number(node));
    const auto table = table_of_.step() ? table_of_.text(0) : "";
    table_of_.reset();
    if (table.empty()) return false;
    auto [it, fresh] = forget_row_.try_emplace(table);
    if (fresh) it->second = sql_.prepare("DELETE FROM " + sql_name(table) + " WHERE id = ?");
    it->second.bind(0, number(node)).run();
    forget_edges_.bind(0, number(node)).run();
    forget_edges_to_.bind(0, number(node)).run();
    forget_dynamic_.bind(0, number(node)).run();
    forget_node_.bind(0, number(node)).run();
    return true;
  }

  void write(NodeId node, TypeId type) {
    const auto& t = numbers_.types[type.value];
    write_node_.bind(0, number(node)).bind(1, t.number).run();
    auto [it, fresh] = write_row_.try_emplace(type);
    if (fresh) {
      std::string names = "id", marks = "?";
      for (const auto& a : t.attributes)
        for (const auto& column : column_names(a.name, a.kind)) names += ", " + column, marks += ", ?";
      it->second = sql_.prepare("INSERT INTO " + sql_name(t.table) + "(" + names + ") VALUES(" + marks + ")");
    }
    it->second.bind(0, number(node));
    std::vector<Value> values;  // stay until the statement has run
    values.reserve(t.attributes.size());
    int at = 1;
    for (const auto& a : t.attributes) {
      bind_columns(it->second, at, values.emplace_back(*world_.get(node, a.id)));
      at += static_cast<int>(columns_of(a.kind).size());
    }
    it->second.run();
  }

  void update(NodeId node, TypeId type, AttributeId attribute) {
    const auto& t = numbers_.types[type.value];
    const Value value = *world_.get(node, attribute);
    const auto count = static_cast<int>(columns_of(kind_of(value)).size());
    auto [it, fresh] = update_.try_emplace({type, attribute});
    if (fresh) {
      std::string set;
      for (const auto& a : t.attributes)
        if (a.id == attribute)
          for (const auto& column : column_names(a.name, a.kind))
            set += (set.empty() ? "" : ", ") + column + " = ?";
      it->second = sql_.prepare("UPDATE " + sql_name(t.table) + " SET " + set + " WHERE id = ?");
    }
    bind_columns(it->second, 0, value);
    it->second.bind(count, number(node)).run();
  }

  void write_dynamic(NodeId node) {
    forget_dynamic_.bind(0, number(node)).run();
    std::vector<double> scratch;
    for (const auto& [name, value] : world_.dynamic_attributes(node)) {
      write_dynamic_.bind(0, number(node)).bind(1, name).bind(2, name_of(kind_of(value)));
      bind_cell(write_dynamic_, 3, value, scratch);
      write_dynamic_.run();
    }
  }

  void write_edges(NodeId node, EdgeTypeId edge) {
    const auto type = numbers_.edges[edge.value];
    forget_edges_of_type_.bind(0, number(node)).bind(1, type).run();
    std::int64_t position = 0;
    for (const auto target : world_.targets(node, edge))
      write_edge_.bind(0, number(node)).bind(1, type).bind(2, position++).bind(3, number(target)).run();
  }

  Sqlite& sql_;
  const FileNumbers& numbers_;
  const Snapshot& world_;
  Statement table_of_, forget_node_, forget_edges_, forget_edges_to_, forget_dynamic_, write_node_,
      write_dynamic_, forget_edges_of_type_, write_edge_;
  std::map<std::string, Statement> forget_row_;
  std::map<TypeId, Statement> write_row_;
  std::map<std::pair<TypeId, AttributeId>, Statement> update_;
};

}  // namespace

void save(Sqlite& sql, const FileNumbers& numbers, const Snapshot& world, const DirtyNodes& dirty) {
  Saver(sql, numbers, world).save(dirty);
}

}  // namespace rigor::world::store
