// The kernel behind Database and Transaction. For the kernel alone.
#pragma once

#include <deque>
#include <memory>
#include <mutex>
#include <string>
#include <unordered_set>
#include <vector>

#include "sim/world/graph/database.h"
#include "sim/world/graph/log.h"
#include "sim/world/graph/signals.h"
#include "sim/world/graph/snapshot_state.h"
#include "sim/world/graph/writer.h"

namespace rigor::world {

struct DatabaseState {
  explicit DatabaseState(const DatabaseOptions& o);
  ~DatabaseState();

  // ------------------------------------------------------------ the world
  DatabaseOptions options;
  Schema schema;
  std::shared_ptr<Memory> memory = std::make_shared<Memory>();
  Writer writer{*memory};
  mutable std::mutex publish_mutex;
  Snapshot published;
  void schema_grew();
  [[nodiscard]] Snapshot take_snapshot();
  void publish(Snapshot s);

  // ------------------------------------------------------------ the open transaction
  bool open = false;
  bool telling = false;  ///< subscribers are being told
  std::string label;
  Log log;
  std::uint64_t first_new = 0;         ///< ids from here on were made by the open transaction
  std::unordered_set<NodeId> low_new;  ///< and these
  const Rule* running = nullptr;       ///< the rule that writes now
  bool rolled_back_by_rule = false;

  void open_transaction(std::string name);
  [[nodiscard]] bool is_new(NodeId n) const {
    return !running && (n.value >= first_new || (!low_new.empty() && low_new.contains(n)));
  }
  void roll_back();
  /// Rules, snapshot, history, subscribers; not the posts.
  [[nodiscard]] Status commit();
  /// Publishes the open transaction, closes it and tells subscribers of it.
  void conclude(ChangeSet set);

  [[nodiscard]] Result<NodeId> create(NodeId wanted, TypeId type);
  [[nodiscard]] Status remove(NodeId node);
  [[nodiscard]] Status set(NodeId node, AttributeId a, ValueKind kind, const void* value);
  [[nodiscard]] Status set_dynamic(NodeId node, std::string_view name, const Value* value);
  [[nodiscard]] Status connect(NodeId source, EdgeTypeId edge, NodeId target);
  [[nodiscard]] Status disconnect(NodeId source, EdgeTypeId edge, NodeId target);

  // ------------------------------------------------------------ rules
  std::deque<Rule> rules;
  std::vector<std::size_t> rule_order;  ///< who feeds another comes first
  [[nodiscard]] Status add_rule(Rule rule);
  [[nodiscard]] Status run_rules();
  [[nodiscard]] Status run_rule(const Rule& rule, std::span<const Change> mine);
  [[nodiscard]] Status may_write(AttributeId a) const;
  [[nodiscard]] Status may_create(TypeId t) const;
  [[nodiscard]] Status may_connect(EdgeTypeId e) const;
  Database* owner = nullptr;

  // ------------------------------------------------------------ history
  struct Step {
    std::string label;
    Log log;
  };
  std::deque<Step> undone, done;  ///< the next to take last
  [[nodiscard]] Status step_back(std::deque<Step>& from, std::deque<Step>& to, const char* what);
  /// Makes a step of the log, where there is something to take back.
  void keep_step(const std::string& name, const ChangeSet& set);

  // ------------------------------------------------------------ signals and posts
  Signals signals;
  struct Post {
    std::string label;
    std::function<Status(Transaction&)> write;
    std::size_t depth;
  };
  std::deque<Post> posts;
  bool draining = false;
  std::size_t depth = 0;  ///< of the transaction that runs now: how many posts led to it
  std::function<void(const Error&)> post_error;
  void drain_posts();
  void post_failed(const std::string& name, const Error& e);

  std::uint64_t commits = 0, rollbacks = 0, told = 0;

  /// `Tree#12`, for messages.
  [[nodiscard]] std::string name_of(NodeId node) const;
  [[nodiscard]] std::string name_of(NodeId node, AttributeId a) const;
};

}  // namespace rigor::world
