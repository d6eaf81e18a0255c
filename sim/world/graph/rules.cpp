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

Status DatabaseState::add_rule(Rule rule) {
  rules.push_back(std::move(rule));
  return {};
}

Status DatabaseState::run_rules() {
  if (rules.empty() || log.empty()) return {};
  constexpr int kMaxRounds = 100;
  std::vector<std::size_t> seen(rules.size(), 0);
  for (int round = 0;; ++round) {
    bool called = false;
    for (std::size_t r = 0; r < rules.size(); ++r) {
      if (seen[r] == log.ops.size()) continue;
      std::vector<Change> mine = net_changes(writer.world, *writer.layout, log, seen[r]);
      seen[r] = log.ops.size();
      std::erase_if(mine, [&](const Change& c) { return !passes(schema, rules[r].when, c); });
      if (mine.empty()) continue;
      if (round >= kMaxRounds)
        return fail(ErrorCode::bad_input, rules[r].name,
                    "the rules find no fixpoint: after " + std::to_string(kMaxRounds) +
                        " rounds this one still has something to do");
      called = true;
      Transaction tx(owner);
      running = &rules[r];
      rolled_back_by_rule = false;
      Status s = rules[r].run(tx, mine);
      const bool refused = rolled_back_by_rule;
      rolled_back_by_rule = false;
      running = nullptr;
      tx.db_ = nullptr;  // it is not the rule's to roll back
      if (s && refused) s = fail(ErrorCode::bad_input, "", "the rule rolled the transaction back");
      if (!s) {
        Error e = s.error();
        e.message = "rule '" + rules[r].name + "' refuses the transaction: " + e.text();
        e.where = label;
        return tl::unexpected(std::move(e));
      }
    }
    if (!called) return {};
  }
}

}  // namespace rigor::world
