#include <utility>

#include "sensor-hal/config/yaml.h"
#include "sim/world/graph/check_value.h"
#include "sim/world/graph/database_state.h"

namespace rigor::world {
namespace {

tl::unexpected<Error> not_open() {
  return fail(ErrorCode::wrong_state, "transaction",
              "it is not open: it was committed or rolled back, or begun while another was open or "
              "subscribers were told (Database::post writes from there)");
}

}  // namespace

#define RIGOR_NEEDS_OPEN                             \
  if (!db_ || !db_->state_->open) return not_open(); \
  DatabaseState& s = *db_->state_

Transaction::Transaction(Transaction&& o) noexcept : db_(std::exchange(o.db_, nullptr)) {}
Transaction::~Transaction() { rollback(); }

Result<NodeId> Transaction::create(TypeId type) {
  RIGOR_NEEDS_OPEN;
  return s.create(NodeId{}, type);
}

Result<NodeId> Transaction::create(std::string_view type) {
  RIGOR_NEEDS_OPEN;
  if (const auto t = s.schema.find_type(type)) return s.create(NodeId{}, *t);
  std::vector<std::string> names;
  for (std::uint32_t i = 0; i < s.schema.type_count(); ++i) names.push_back(s.schema.type(TypeId{i}).name);
  const std::string near = nearest(type, names);
  return fail(ErrorCode::bad_input, std::string(type),
              "no such node type" + (near.empty() ? "" : "; did you mean '" + near + "'?"));
}

Status Transaction::create_as(NodeId id, TypeId type) {
  RIGOR_NEEDS_OPEN;
  if (!id) return fail(ErrorCode::bad_input, "node#0", "0 is no node: ids count from 1");
  if (auto n = s.create(id, type); !n) return tl::unexpected(n.error());
  return {};
}

Status Transaction::remove(NodeId node) {
  RIGOR_NEEDS_OPEN;
  return s.remove(node);
}

Status Transaction::set(NodeId node, AttributeId attribute, Value value) {
  RIGOR_NEEDS_OPEN;
  return s.set(node, attribute, kind_of(value), address_of(value));
}

Status Transaction::set(NodeId node, std::string_view name, Value value) {
  RIGOR_NEEDS_OPEN;
  const Location l = s.writer.world.location(node);
  if (!l.is_there())
    return fail(ErrorCode::bad_input, s.name_of(node) + "." + std::string(name), "there is no such node");
  if (const auto a = s.schema.find_attribute(TypeId{l.type - 1}, name))
    return s.set(node, *a, kind_of(value), address_of(value));
  const DynamicMap* map = s.writer.world.dynamic_map(node);
  if (map && map->values.contains(name)) return s.set_dynamic(node, name, &value);
  std::vector<std::string> names;
  for (const AttributeId a : s.schema.attributes(TypeId{l.type - 1}))
    names.push_back(s.schema.attribute(a).spec.name);
  if (map)
    for (const auto& [n, v] : map->values) names.push_back(n);
  const std::string near = nearest(name, names);
  return fail(ErrorCode::bad_input, s.name_of(node) + "." + std::string(name),
              "no such attribute" + (near.empty() ? "" : "; did you mean '" + near + "'?") +
                  " (set_dynamic makes one of this node alone)");
}

Status Transaction::set_dynamic(NodeId node, std::string_view name, Value value) {
  RIGOR_NEEDS_OPEN;
  return s.set_dynamic(node, name, &value);
}

Status Transaction::erase_dynamic(NodeId node, std::string_view name) {
  RIGOR_NEEDS_OPEN;
  return s.set_dynamic(node, name, nullptr);
}

Status Transaction::connect(NodeId source, EdgeTypeId edge, NodeId target) {
  RIGOR_NEEDS_OPEN;
  return s.connect(source, edge, target);
}

Status Transaction::disconnect(NodeId source, EdgeTypeId edge, NodeId target) {
  RIGOR_NEEDS_OPEN;
  return s.disconnect(source, edge, target);
}

Status Transaction::set_typed(NodeId node, AttributeId attribute, ValueKind kind, void* value) {
  RIGOR_NEEDS_OPEN;
  return s.set(node, attribute, kind, value);
}

const void* Transaction::find(NodeId node, AttributeId attribute) const noexcept {
  if (!db_) return nullptr;
  const Writer& w = db_->state_->writer;
  return w.layout->find(w.world, node, attribute);
}

Snapshot Transaction::view() const { return db_ ? db_->state_->take_snapshot() : Snapshot(); }

Status Transaction::commit() {
  RIGOR_NEEDS_OPEN;
  if (s.running)
    return fail(ErrorCode::wrong_state, s.running->name,
                "a rule may not commit: the transaction that it serves does");
  db_ = nullptr;
  const auto keep_alive = s.owner->state_;
  const Status done = s.commit();
  s.drain_posts();
  return done;
}

void Transaction::rollback() {
  if (!db_ || !db_->state_->open) return;
  DatabaseState& s = *db_->state_;
  if (s.running) {  // the rule refuses the whole transaction
    s.rolled_back_by_rule = true;
    return;
  }
  db_ = nullptr;
  s.roll_back();
  s.drain_posts();
}

#undef RIGOR_NEEDS_OPEN

}  // namespace rigor::world
