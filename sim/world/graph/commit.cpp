// From the last write of a transaction to the last subscriber.
#include <utility>

#include "sim/world/graph/database_state.h"
#include "sim/world/graph/net_changes.h"

namespace rigor::world {
namespace {

constexpr std::size_t kMaxPostDepth = 1000;

}  // namespace

DatabaseState::DatabaseState(const DatabaseOptions& o) : options(o) { schema_grew(); }

DatabaseState::~DatabaseState() {
  memory->adopt(writer.world.locations.root);
  memory->adopt(writer.world.tables);
  memory->adopt(writer.world.edges);
  memory->adopt(writer.world.dynamics.root);
}

void DatabaseState::schema_grew() {
  writer.layout = Layout::make(schema, writer.layout.get());
  writer.fit_layout();
  publish(take_snapshot());
}

Snapshot DatabaseState::take_snapshot() {
  writer.settle_places();
  auto state = std::make_shared<SnapshotState>();
  state->world = writer.world;
  state->layout = writer.layout;
  state->version = memory->seal();
  state->memory = memory;
  return Snapshot(std::move(state));
}

void DatabaseState::publish(Snapshot s) {
  {
    const std::lock_guard lock(publish_mutex);
    std::swap(published, s);
  }
  s = Snapshot();  // the one before, where nobody else holds it
  memory->collect();
}

void DatabaseState::open_transaction(std::string name) {
  open = true;
  label = std::move(name);
  log.clear();
  writer.log = &log;
  first_new = writer.world.next_id;
  low_new.clear();
}

void DatabaseState::roll_back() {
  writer.log = nullptr;
  for (std::size_t i = log.ops.size(); i > 0; --i) writer.invert(log, i - 1, true);
  log.clear();
  open = false;
  ++rollbacks;
}

Status DatabaseState::commit() {
  const std::size_t posts_before = posts.size();
  if (auto s = run_rules(); !s) {
    posts.resize(posts_before);  // what refused rules posted goes with all else
    roll_back();
    return s;
  }
  std::string name = std::move(label);
  ChangeSet set;
  if (!signals.empty()) set.changes = net_changes(writer.world, *writer.layout, log);
  keep_step(name, set);
  set.label = std::move(name);
  conclude(std::move(set));
  return {};
}

void DatabaseState::conclude(ChangeSet set) {
  log.clear();
  open = false;
  ++writer.world.revision;
  ++commits;
  set.revision = writer.world.revision;
  Snapshot after = take_snapshot();
  if (set.changes.empty()) {
    publish(std::move(after));
    return;
  }
  set.before = published;
  set.after = after;
  publish(std::move(after));
  telling = true;
  told += signals.deliver(writer.layout->schema, set);
  telling = false;
}

void DatabaseState::drain_posts() {
  if (draining || open || telling) return;
  draining = true;
  while (!posts.empty()) {
    Post post = std::move(posts.front());
    posts.pop_front();
    if (post.depth > kMaxPostDepth) {
      post_failed(post.label, Error{ErrorCode::wrong_state, post.label,
                                    "a post led to a post a thousand times over: subscribers answer each "
                                    "other without end"});
      continue;
    }
    depth = post.depth;
    Transaction tx = owner->begin(post.label);
    Status s = post.write(tx);
    if (s && open) s = tx.commit();
    if (!s) {
      tx.rollback();
      post_failed(post.label, s.error());
    }
  }
  depth = 0;
  draining = false;
}

void DatabaseState::post_failed(const std::string&, const Error& e) {
  if (post_error) post_error(e);
}

}  // namespace rigor::world
