// The active semantic graph database: the micro-kernel of the simulation. One thread writes (the world
// thread); every thread reads snapshots.
//
//   auto db = Database::create();
//   define_semantic_types(*db);                                   // sim/world/semantic_types.h
//   const types::Tree tree(db->schema());
//   auto watch = db->subscribe({.type = tree.type}, [](const ChangeSet& set, std::span<const Change> mine) {
//   … }); Transaction tx = db->begin("plant"); NodeId oak = *tx.create(tree.type); tx.set(oak, tree.species,
//   std::string("QURO")); Status s = tx.commit();                                       // rules, snapshot,
//   then subscribers
//
// A transaction: writes → rules to their fixpoint (one undo step; a rule may veto: all is rolled back) → one
// snapshot → subscribers. What subscribers write (Database::post) queues the next transaction, which runs
// when all have been told. A subscriber never sees a half-done change, and is told once, in the order of
// commits.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "rt-core/result.h"
#include "sim/world/graph/changes.h"
#include "sim/world/graph/schema.h"
#include "sim/world/graph/snapshot.h"

namespace rigor::world {

class Database;
struct DatabaseState;  // sim/world/graph/database_state.h, for the kernel alone

/// Writes that take effect together or not at all. Reads see its own writes. World thread; at most one is
/// open.
class Transaction {
 public:
  Transaction(Transaction&&) noexcept;
  Transaction& operator=(Transaction&&) = delete;
  ~Transaction();  ///< rolls back what was not committed

  /// Errors of all writes: bad_input (unknown or abstract type, no such node, wrong kind, value outside its
  /// limits, cardinality, a ring in an acyclic edge). A write that is refused changes nothing; the
  /// transaction stays open.
  [[nodiscard]] Result<NodeId> create(TypeId type);
  [[nodiscard]] Result<NodeId> create(std::string_view type);
  /// With an id of its own choosing, for loading. bad_input: taken.
  [[nodiscard]] Status create_as(NodeId id, TypeId type);
  /// Its edges go with it, and the sources of edges that say removes_sources.
  [[nodiscard]] Status remove(NodeId node);
  template <class T>
  [[nodiscard]] Status set(NodeId node, Attribute<T> attribute, T value) {
    return set_typed(node, attribute.id, kKindOf<T>, &value);
  }
  [[nodiscard]] Status set(NodeId node, AttributeId attribute, Value value);
  /// By name: own, inherited, else a dynamic attribute of this node that exists already.
  [[nodiscard]] Status set(NodeId node, std::string_view name, Value value);
  /// Makes or changes an attribute that this node alone has.
  [[nodiscard]] Status set_dynamic(NodeId node, std::string_view name, Value value);
  [[nodiscard]] Status erase_dynamic(NodeId node, std::string_view name);
  [[nodiscard]] Status connect(NodeId source, EdgeTypeId edge, NodeId target);
  [[nodiscard]] Status disconnect(NodeId source, EdgeTypeId edge, NodeId target);

  /// The world as this transaction has made it so far. Cheap, but each write after it may copy what it
  /// shares.
  [[nodiscard]] Snapshot view() const;
  template <class T>
  [[nodiscard]] const T* get(NodeId node, Attribute<T> attribute) const noexcept {
    return static_cast<const T*>(find(node, attribute.id));
  }

  /// Runs the rules, then makes the change known. On an error (a veto; rules without a fixpoint) all is
  /// rolled back and the message names the rule.
  [[nodiscard]] Status commit();
  void rollback();

 private:
  friend class Database;
  friend struct DatabaseState;
  explicit Transaction(Database* db) : db_(db) {}
  [[nodiscard]] Status set_typed(NodeId node, AttributeId attribute, ValueKind kind, void* value);
  [[nodiscard]] const void* find(NodeId node, AttributeId attribute) const noexcept;
  Database* db_;
};

/// What a subscriber or a rule wants to hear of. Empty fields: any. Given together, all must hold.
struct Filter {
  std::optional<TypeId> type{};            ///< with subtypes
  std::optional<AttributeId> attribute{};  ///< `changed` of this attribute alone
  NodeId node{};
  std::optional<EdgeTypeId> edge{};  ///< connected and disconnected of this edge alone
};

/// `mine`: the changes of `set` that pass the filter, in order, never empty. World thread, after the commit.
/// Writes go through Database::post. May subscribe and unsubscribe, itself too.
using Subscriber = std::function<void(const ChangeSet& set, std::span<const Change> mine)>;

/// Keeps a subscription alive. May end before or after the database.
class [[nodiscard]] Subscription {
 public:
  Subscription() = default;
  Subscription(Subscription&&) noexcept;
  Subscription& operator=(Subscription&&) noexcept;
  ~Subscription();
  void end();

 private:
  friend class Database;
  std::weak_ptr<DatabaseState> db_;
  std::uint64_t id_ = 0;
};

/// A rule keeps something true. It is run within a transaction for changes that pass its filter, may write
/// more (which can call on other rules), and refuses the whole transaction by returning an error. What it
/// `writes` is declared, and a write that is not is refused: rules whose reads and writes form a ring are
/// refused when they are added. Rules run in the order in which they feed each other, else of their adding.
/// A rule whose filter names neither attribute nor edge may hear of its own writes; it is run until it is
/// content, and a transaction that finds no end fails.
struct Rule {
  std::string name;
  Filter when;
  std::vector<AttributeId> writes = {};   ///< attributes that it may set
  std::vector<TypeId> creates = {};       ///< types that it may create or remove
  std::vector<EdgeTypeId> connects = {};  ///< edges that it may connect or disconnect
  std::function<Status(Transaction& tx, std::span<const Change> mine)> run;
  /// Where not empty, what it hears of is narrowed to nodes created (first values have no `changed`) and
  /// `changed` of these attributes; `when` holds besides.
  std::vector<AttributeId> reads = {};
};

struct DatabaseOptions {
  std::size_t undo_steps = 100;  ///< kept at most; 0: none
};

class Database {
 public:
  [[nodiscard]] static std::unique_ptr<Database> create(const DatabaseOptions& options = {});
  ~Database();
  Database(const Database&) = delete;
  Database& operator=(const Database&) = delete;

  // Schema. World thread, outside transactions. Existing nodes get a new attribute's default.
  Result<TypeId> define(const TypeSpec& spec);
  Result<EdgeTypeId> define(const EdgeSpec& spec);
  Result<AttributeId> add_attribute(TypeId type, const AttributeSpec& spec);
  [[nodiscard]] const Schema& schema() const noexcept;

  /// Precondition: no transaction is open.
  [[nodiscard]] Transaction begin(std::string label = "");
  /// Runs `write` in a transaction of its own once the present one has been told of; at once where none is
  /// open. What a post returns as an error rolls that transaction back and goes to the handler of
  /// on_post_error. World thread.
  void post(std::string label, std::function<Status(Transaction&)> write);
  void on_post_error(std::function<void(const Error&)> handler);

  /// bad_input: nothing to undo. Transient attributes keep their present value.
  [[nodiscard]] Status undo();
  [[nodiscard]] Status redo();
  [[nodiscard]] std::vector<std::string> undo_labels() const;  ///< the next to be undone last
  [[nodiscard]] std::vector<std::string> redo_labels() const;
  void forget_history();

  Subscription subscribe(const Filter& filter, Subscriber subscriber);
  /// bad_input: a ring of rules (the message names it), a rule without a name, a name twice. Outside
  /// transactions.
  [[nodiscard]] Status add_rule(Rule rule);

  /// The last committed world. Any thread.
  [[nodiscard]] Snapshot snapshot() const;

  struct Statistics {
    std::uint64_t commits = 0, rollbacks = 0, signals = 0;
    std::size_t bytes = 0;  ///< estimate of what nodes, attributes, edges and indices hold
  };
  [[nodiscard]] Statistics statistics() const;

  [[nodiscard]] DatabaseState& state() noexcept { return *state_; }

 private:
  friend class Transaction;
  friend struct DatabaseState;
  Database() = default;
  std::shared_ptr<DatabaseState> state_;
};

}  // namespace rigor::world
