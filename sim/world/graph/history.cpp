#include <algorithm>

#include "sim/world/graph/database_state.h"
#include "sim/world/graph/net_changes.h"

namespace rigor::world {

namespace {

/// Whether a transaction did more than to write transient attributes. `told`: its net changes, where they are
/// known; empty also where nobody asked.
bool lasts(const World& now, const Layout& layout, const Log& log, const std::vector<Change>& told) {
  const auto change_lasts = [&](const Change& c) {
    return c.kind != ChangeKind::changed || !c.dynamic.empty() || !layout.transient[c.attribute.value];
  };
  if (!told.empty() && std::any_of(told.begin(), told.end(), change_lasts)) return true;
  bool maybe = false;
  for (const Op& op : log.ops) {
    if (op.kind == OpKind::disconnect) return true;  // joined again, it is another order
    maybe |= op.kind != OpKind::set || !layout.transient[op.what];
  }
  if (!maybe) return false;
  if (log.ops.size() == 1) return true;  // a step alone is never without effect
  const auto changes = net_changes(now, layout, log);
  return std::any_of(changes.begin(), changes.end(), change_lasts);
}

}  // namespace

void DatabaseState::keep_step(const std::string& name, const ChangeSet& set) {
  if (options.undo_steps == 0 || log.empty() || !lasts(writer.world, *writer.layout, log, set.changes))
    return;
  std::erase_if(log.ops,
                [&](const Op& op) { return op.kind == OpKind::set && writer.layout->transient[op.what]; });
  undone.clear();
  done.push_back({name, std::move(log)});
  log = Log();
  while (done.size() > options.undo_steps) done.pop_front();
}

Status DatabaseState::step_back(std::deque<Step>& from, std::deque<Step>& to, const char* what) {
  if (open || telling)
    return fail(ErrorCode::wrong_state, what, "a transaction is open, or subscribers are being told");
  if (from.empty()) return fail(ErrorCode::bad_input, what, std::string("there is nothing to ") + what);
  Step step = std::move(from.back());
  from.pop_back();
  open_transaction("");
  first_new = ~std::uint64_t{0};  // every step is logged
  for (std::size_t i = step.log.ops.size(); i > 0; --i) writer.invert(step.log, i - 1, false);
  ChangeSet set;
  if (!signals.empty()) set.changes = net_changes(writer.world, *writer.layout, log);
  set.label = std::string(what) + ": " + step.label;
  Step back{std::move(step.label), std::move(log)};
  log = Log();
  to.push_back(std::move(back));
  conclude(std::move(set));
  drain_posts();
  return {};
}

}  // namespace rigor::world
