#include "sim/world/graph/database.h"

#include <utility>

#include "sim/world/graph/database_state.h"

namespace rigor::world {

std::unique_ptr<Database> Database::create(const DatabaseOptions& options) {
  std::unique_ptr<Database> db(new Database);
  db->state_ = std::make_shared<DatabaseState>(options);
  db->state_->owner = db.get();
  return db;
}

Database::~Database() = default;

namespace {

Status may_define(const DatabaseState& s, const std::string& name) {
  if (!s.open) return {};
  return fail(ErrorCode::wrong_state, name, "the schema grows outside transactions alone");
}

}  // namespace

Result<TypeId> Database::define(const TypeSpec& spec) {
  if (auto s = may_define(*state_, spec.name); !s) return tl::unexpected(s.error());
  auto t = state_->schema.define(spec);
  if (t) state_->schema_grew();
  return t;
}

Result<EdgeTypeId> Database::define(const EdgeSpec& spec) {
  if (auto s = may_define(*state_, spec.name); !s) return tl::unexpected(s.error());
  auto e = state_->schema.define(spec);
  if (e) state_->schema_grew();
  return e;
}

Result<AttributeId> Database::add_attribute(TypeId type, const AttributeSpec& spec) {
  if (auto s = may_define(*state_, spec.name); !s) return tl::unexpected(s.error());
  auto a = state_->schema.add_attribute(type, spec);
  if (a) state_->schema_grew();
  return a;
}

const Schema& Database::schema() const noexcept { return state_->schema; }

Transaction Database::begin(std::string label) {
  if (state_->open || state_->telling) return Transaction(nullptr);
  state_->open_transaction(std::move(label));
  return Transaction(this);
}

void Database::post(std::string label, std::function<Status(Transaction&)> write) {
  state_->posts.push_back({std::move(label), std::move(write), state_->depth + 1});
  state_->drain_posts();
}

void Database::on_post_error(std::function<void(const Error&)> handler) {
  state_->post_error = std::move(handler);
}

Status Database::undo() { return state_->step_back(state_->done, state_->undone, "undo"); }
Status Database::redo() { return state_->step_back(state_->undone, state_->done, "redo"); }

std::vector<std::string> Database::undo_labels() const {
  std::vector<std::string> labels;
  for (const auto& s : state_->done) labels.push_back(s.label);
  return labels;
}
std::vector<std::string> Database::redo_labels() const {
  std::vector<std::string> labels;
  for (const auto& s : state_->undone) labels.push_back(s.label);
  return labels;
}

void Database::forget_history() {
  state_->done.clear();
  state_->undone.clear();
}

Subscription Database::subscribe(const Filter& filter, Subscriber subscriber) {
  Subscription s;
  s.db_ = state_;
  s.id_ = state_->signals.add(filter, std::move(subscriber));
  return s;
}

Subscription::Subscription(Subscription&& o) noexcept : db_(std::move(o.db_)), id_(std::exchange(o.id_, 0)) {}
Subscription& Subscription::operator=(Subscription&& o) noexcept {
  if (this != &o) {
    end();
    db_ = std::move(o.db_);
    id_ = std::exchange(o.id_, 0);
  }
  return *this;
}
Subscription::~Subscription() { end(); }
void Subscription::end() {
  if (id_ != 0)
    if (const auto db = db_.lock()) db->signals.end(id_);
  id_ = 0;
}

Status Database::add_rule(Rule rule) { return state_->add_rule(std::move(rule)); }

Snapshot Database::snapshot() const {
  const std::lock_guard lock(state_->publish_mutex);
  return state_->published;
}

Database::Statistics Database::statistics() const {
  const DatabaseState& s = *state_;
  std::size_t bytes = s.memory->bytes() + s.log.bytes();
  for (const auto* steps : {&s.done, &s.undone})
    for (const auto& step : *steps) bytes += step.log.bytes();
  return {.commits = s.commits, .rollbacks = s.rollbacks, .signals = s.told, .bytes = bytes};
}

}  // namespace rigor::world
