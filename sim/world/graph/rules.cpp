#include <algorithm>

#include "sim/world/graph/database_state.h"
#include "sim/world/graph/net_changes.h"

namespace rigor::world {

Status DatabaseState::may_write(AttributeId a) const {
  if (!running || std::find(running->writes.begin(), running->writes.end(), a) != running->writes.end())
    return {};
  return fail(ErrorCode::bad_input, running->name,
              "the rule writes " + schema.attribute(a).spec.name + ", which its `writes` does not name");
}

Status DatabaseState::may_create(TypeId t) const {
  if (!running) return {};
  for (const TypeId c : running->creates)
    if (schema.is_a(t, c)) return {};
  return fail(ErrorCode::bad_input, running->name,
              "the rule makes or removes a " + schema.type(t).name + ", which its `creates` does not name");
}

Status DatabaseState::may_connect(EdgeTypeId e) const {
  if (!running || std::find(running->connects.begin(), running->connects.end(), e) != running->connects.end())
    return {};
  return fail(ErrorCode::bad_input, running->name,
              "the rule connects " + schema.edge(e).name + ", which its `connects` does not name");
}

namespace {

bool related(const Schema& s, TypeId a, const std::optional<TypeId>& b) {
  return !b || s.is_a(a, *b) || s.is_a(*b, a);
}

template <class T>
bool among(const std::vector<T>& list, T item) {
  return std::find(list.begin(), list.end(), item) != list.end();
}

enum class Calls { no, perhaps, surely };

/// Whether what `a` writes is heard by `b`; surely: b names it.
Calls calls(const Schema& s, const Rule& a, const Rule& b) {
  const bool narrow = b.when.attribute || b.when.edge || !b.reads.empty();
  for (const AttributeId w : a.writes) {
    if (b.when.edge || !related(s, s.attribute(w).owner, b.when.type)) continue;
    if (b.when.attribute == w || among(b.reads, w)) return Calls::surely;
  }
  for (const EdgeTypeId e : a.connects)
    if (b.when.edge == e && related(s, s.require_type(s.edge(e).from), b.when.type)) return Calls::surely;
  for (const TypeId c : a.creates) {
    if (b.when.edge && (related(s, c, s.require_type(s.edge(*b.when.edge).from)) ||
                        related(s, c, s.require_type(s.edge(*b.when.edge).to))))
      return Calls::perhaps;  // removing a node cuts its edges
    if (!b.when.edge && !b.when.attribute && related(s, c, b.when.type)) return Calls::perhaps;
  }
  if (narrow) return Calls::no;
  for (const AttributeId w : a.writes)
    if (related(s, s.attribute(w).owner, b.when.type)) return Calls::perhaps;
  for (const EdgeTypeId e : a.connects)
    if (related(s, s.require_type(s.edge(e).from), b.when.type)) return Calls::perhaps;
  return Calls::no;
}

bool hears(const Schema& schema, const Rule& rule, const Change& c) {
  if (!passes(schema, rule.when, c)) return false;
  if (rule.reads.empty()) return true;
  return c.kind == ChangeKind::created || (c.kind == ChangeKind::changed && among(rule.reads, c.attribute));
}

Status check_ids(const Schema& s, const Rule& r) {
  const auto attribute = [&](AttributeId a) { return a.value < s.attribute_count(); };
  const auto type = [&](TypeId t) { return t.value < s.type_count(); };
  const auto edge = [&](EdgeTypeId e) { return e.value < s.edge_type_count(); };
  if (std::all_of(r.writes.begin(), r.writes.end(), attribute) &&
      std::all_of(r.reads.begin(), r.reads.end(), attribute) &&
      std::all_of(r.creates.begin(), r.creates.end(), type) &&
      std::all_of(r.connects.begin(), r.connects.end(), edge) &&
      (!r.when.attribute || attribute(*r.when.attribute)) && (!r.when.type || type(*r.when.type)) &&
      (!r.when.edge || edge(*r.when.edge)))
    return {};
  return fail(ErrorCode::bad_input, r.name, "the rule names an attribute, type or edge that is not defined");
}

}  // namespace

Status DatabaseState::add_rule(Rule rule) {
  if (open || telling)
    return fail(ErrorCode::wrong_state, rule.name, "rules are added outside transactions alone");
  if (rule.name.empty()) return fail(ErrorCode::bad_input, "rule", "a rule needs a name");
  if (!rule.run) return fail(ErrorCode::bad_input, rule.name, "the rule has nothing to run");
  for (const Rule& r : rules)
    if (r.name == rule.name)
      return fail(ErrorCode::bad_input, rule.name, "a rule of this name is there already");
  if (auto s = check_ids(schema, rule); !s) return s;
  if (calls(schema, rule, rule) == Calls::surely)
    return fail(ErrorCode::bad_input, rule.name, "the rule writes what it reads: it would call on itself");

  rules.push_back(std::move(rule));
  const std::size_t n = rules.size(), mine = n - 1;
  const auto feeds = [&](std::size_t a, std::size_t b) {
    return a != b && calls(schema, rules[a], rules[b]) != Calls::no;
  };
  // Rules before this one form no ring, so a ring leads through it.
  std::vector<std::size_t> came_from(n, n), stack{mine};
  while (!stack.empty()) {
    const std::size_t r = stack.back();
    stack.pop_back();
    for (std::size_t next = 0; next < n; ++next) {
      if (!feeds(r, next)) continue;
      if (next == mine) {
        std::string ring = rules[mine].name;
        for (std::size_t at = r; at != mine; at = came_from[at]) ring = rules[at].name + " -> " + ring;
        ring = rules[mine].name + " -> " + ring;
        std::string name = rules[mine].name;
        rules.pop_back();
        return fail(ErrorCode::bad_input, std::move(name),
                    "the rules form a ring, each writing what the next reads: " + ring +
                        " (a filter that names an attribute hears less)");
      }
      if (came_from[next] != n) continue;
      came_from[next] = r;
      stack.push_back(next);
    }
  }
  rule_order.clear();
  std::vector<bool> placed(n, false);
  while (rule_order.size() < n)
    for (std::size_t r = 0; r < n; ++r) {
      if (placed[r]) continue;
      bool is_fed = false;
      for (std::size_t other = 0; other < n && !is_fed; ++other) is_fed = !placed[other] && feeds(other, r);
      if (is_fed) continue;
      placed[r] = true;
      rule_order.push_back(r);
      break;
    }
  return {};
}

Status DatabaseState::run_rule(const Rule& rule, std::span<const Change> mine) {
  Transaction tx(owner);
  running = &rule;
  rolled_back_by_rule = false;
  Status s = rule.run(tx, mine);
  running = nullptr;
  tx.db_ = nullptr;  // it is not the rule's to roll back
  if (s && rolled_back_by_rule) s = fail(ErrorCode::bad_input, "", "it rolled the transaction back");
  rolled_back_by_rule = false;
  if (s) return {};
  Error e = s.error();
  e.message = "rule '" + rule.name + "' refuses the transaction: " + e.text();
  e.where = label;
  return tl::unexpected(std::move(e));
}

Status DatabaseState::run_rules() {
  if (rules.empty() || log.empty()) return {};
  constexpr int kMaxRounds = 100;
  std::vector<std::size_t> seen(rules.size(), 0);
  std::vector<Change> changes, mine;
  std::size_t from = ~std::size_t{0}, to = 0;
  for (int round = 0;; ++round) {
    bool called = false;
    for (const std::size_t r : rule_order) {
      if (seen[r] == log.ops.size()) continue;
      if (from != seen[r] || to != log.ops.size()) {
        from = seen[r];
        to = log.ops.size();
        changes = net_changes(writer.world, *writer.layout, log, from);
      }
      seen[r] = to;
      mine.clear();
      for (const Change& c : changes)
        if (hears(schema, rules[r], c)) mine.push_back(c);
      if (mine.empty()) continue;
      if (round >= kMaxRounds)
        return fail(ErrorCode::bad_input, label,
                    "rule '" + rules[r].name + "' finds no fixpoint: after " + std::to_string(kMaxRounds) +
                        " rounds it still changes what it hears of");
      called = true;
      if (auto s = run_rule(rules[r], mine); !s) return s;
    }
    if (!called) return {};
  }
}

}  // namespace rigor::world
