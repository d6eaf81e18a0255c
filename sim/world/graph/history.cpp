#include "sim/world/graph/database_state.h"
#include "sim/world/graph/net_changes.h"

namespace rigor::world {

bool DatabaseState::keep_log(Step& step) {
  if (options.undo_steps == 0) return false;
  std::erase_if(log.ops,
                [&](const Op& op) { return op.kind == OpKind::set && writer.layout->transient[op.what]; });
  if (log.ops.empty()) return false;
  step.log = std::move(log);
  log = Log();
  return true;
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
