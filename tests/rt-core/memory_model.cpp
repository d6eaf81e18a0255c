#include "tests/rt-core/memory_model.h"

#include <algorithm>

namespace rigor::test {

Model* Model::current_ = nullptr;

void Model::View::join(const View& o) {
  if (store.size() < o.store.size()) store.resize(o.store.size());
  for (std::size_t i = 0; i < o.store.size(); ++i) store[i] = std::max(store[i], o.store[i]);
  for (std::size_t i = 0; i < kThreads; ++i) clock[i] = std::max(clock[i], o.clock[i]);
}

Outcome Model::explore(const std::function<void(Model&)>& setup, const Weakened& weakened) {
  Model* const before = std::exchange(current_, this);
  outcome_ = {};
  weakened_ = weakened;
  writers_.clear();
  do {
    writers_grew_ = false;
    choices_.clear();
    do {
      run_once(setup);
      ++outcome_.executions;
      while (!choices_.empty() && choices_.back().taken + 1 == choices_.back().count) choices_.pop_back();
      if (!choices_.empty()) ++choices_.back().taken;
    } while (!choices_.empty() && outcome_.failure.empty() && !writers_grew_);
  } while (writers_grew_ && outcome_.failure.empty());
  current_ = before;
  return outcome_;
}

void Model::run_once(const std::function<void(Model&)>& setup) {
  depth_ = running_ = 0;
  over_ = false;
  after_ = nullptr;
  threads_.clear();
  threads_.reserve(kThreads);  // contexts do not move
  locations_.clear();
  data_.clear();
  threads_.emplace_back();
  me().view.clock[0] = 1;
  setup(*this);
  while (stacks_.size() < threads_.size()) stacks_.push_back(std::make_unique<std::array<char, 64 << 10>>());
  for (std::size_t i = 1; i < threads_.size(); ++i) {
    Thread& t = threads_[i];
    t.view = threads_[0].view;
    t.view.clock[i] = 1;
    getcontext(&t.context);
    t.context.uc_stack.ss_sp = stacks_[i]->data();
    t.context.uc_stack.ss_size = stacks_[i]->size();
    t.context.uc_link = nullptr;
    makecontext(&t.context, &Model::trampoline, 0);
    // To where it first shares something.
    running_ = i;
    swapcontext(&scheduler_, &t.context);
  }
  std::vector<std::size_t> left;
  while (!over_) {
    left.clear();
    for (std::size_t i = 1; i < threads_.size(); ++i)
      if (!threads_[i].ended) left.push_back(i);
    if (left.empty()) break;
    running_ = left[choose(left.size())];
    swapcontext(&scheduler_, &me().context);
  }
  // What was not finished is left where it is: this leaks what it owns, in an execution that fails or does
  // not count.
  const std::size_t ended = running_ = 0;
  for (Thread& t : threads_) threads_[ended].view.join(t.view);
  if (!over_ && after_) after_();
  for (Thread& t : threads_) t.body = nullptr;
  after_ = nullptr;
}

void Model::trampoline() {
  Model& m = *current_;
  m.me().body();
  m.me().ended = true;
  m.yield_to_scheduler();
}

void Model::thread(std::function<void()> body, std::uint32_t max_accesses) {
  threads_.emplace_back();
  threads_.back().body = std::move(body);
  threads_.back().accesses_left = max_accesses;
}

void Model::yield_to_scheduler() { swapcontext(&me().context, &scheduler_); }

void Model::fail(const std::string& what) {
  if (outcome_.failure.empty()) outcome_.failure = what;
  give_up();
}

void Model::give_up() {
  over_ = true;
  if (running_ != 0) yield_to_scheduler();
}

std::size_t Model::choose(std::size_t count) {
  if (count == 1) return 0;
  if (depth_ == choices_.size()) choices_.push_back({0, count});
  return choices_[depth_++].taken;
}

void Model::maybe_switch(std::size_t atomic, bool writes) {
  if (running_ == 0) return;
  if (me().accesses_left-- == 0) give_up();
  const unsigned bit = 1u << running_;
  if (writers_.size() <= atomic) writers_.resize(atomic + 1);
  if (writes && !(writers_[atomic] & bit)) {
    writers_[atomic] |= bit;
    writers_grew_ = true;
  }
  if (writers_[atomic] & ~bit) yield_to_scheduler();
}

std::memory_order Model::order_at(std::memory_order order, const std::source_location& where) {
  if (order == std::memory_order_relaxed) return order;
  std::string file = where.file_name();
  const Site site = file.substr(file.rfind('/') + 1) + ":" + std::to_string(where.line()) + ":" +
                    std::to_string(where.column());
  if (running_ != 0) outcome_.sites.insert({site, order});
  return site == weakened_.site ? weakened_.order : order;
}

namespace {
bool acquires(std::memory_order o) {
  return o != std::memory_order_relaxed && o != std::memory_order_release;
}
bool releases(std::memory_order o) {
  return o != std::memory_order_relaxed && o != std::memory_order_acquire && o != std::memory_order_consume;
}
}  // namespace

std::size_t Model::new_atomic(std::uint64_t value) {
  locations_.emplace_back();
  const std::size_t atomic = locations_.size() - 1;
  me().view.store.resize(locations_.size());
  locations_[atomic].stores.push_back({value, me().view});
  step(atomic);
  return atomic;
}

void Model::end_atomic(std::size_t atomic) {
  for (std::size_t i = 0; i < threads_.size(); ++i)
    if (locations_[atomic].accessed[i] > me().view.clock[i]) return fail("an atomic ends while it is in use");
}

void Model::step(std::size_t atomic) { locations_[atomic].accessed[running_] = ++me().view.clock[running_]; }

void Model::acquire(const View& told, std::memory_order order) {
  (acquires(order) ? me().view : me().for_acquire_fence).join(told);
}

Model::View Model::told_by(std::memory_order order, std::size_t atomic) {
  View told = releases(order) ? me().view : me().at_release_fence;
  told.store.resize(locations_.size());
  told.store[atomic] = me().view.store[atomic];
  return told;
}

std::uint64_t Model::load(std::size_t atomic, std::memory_order order, const std::source_location& where) {
  order = order_at(order, where);
  maybe_switch(atomic, false);
  auto& seen = me().view.store;
  seen.resize(locations_.size());
  const std::size_t count = locations_[atomic].stores.size();
  // The newest first.
  const std::size_t read = count - 1 - choose(count - seen[atomic]);
  seen[atomic] = static_cast<std::uint32_t>(read);
  step(atomic);
  acquire(locations_[atomic].stores[read].told, order);
  return locations_[atomic].stores[read].value;
}

void Model::store(std::size_t atomic, std::uint64_t value, std::memory_order order,
                  const std::source_location& where) {
  order = order_at(order, where);
  maybe_switch(atomic, true);
  me().view.store.resize(locations_.size());
  me().view.store[atomic] = static_cast<std::uint32_t>(locations_[atomic].stores.size());
  step(atomic);
  locations_[atomic].stores.push_back({value, told_by(order, atomic)});
}

std::uint64_t Model::modify(std::size_t atomic, const std::function<std::uint64_t(std::uint64_t)>& change,
                            std::memory_order order, const std::source_location& where) {
  order = order_at(order, where);
  maybe_switch(atomic, true);
  me().view.store.resize(locations_.size());
  const Store last = locations_[atomic].stores.back();
  me().view.store[atomic] = static_cast<std::uint32_t>(locations_[atomic].stores.size());
  step(atomic);
  acquire(last.told, order);
  View told = told_by(order, atomic);
  told.join(last.told);  // the release sequence goes on
  locations_[atomic].stores.push_back({change(last.value), std::move(told)});
  return last.value;
}

void Model::fence(bool acquire, bool release, const std::source_location& where) {
  const auto order = acquire && release ? std::memory_order_acq_rel
                     : acquire          ? std::memory_order_acquire
                                        : std::memory_order_release;
  if (order_at(order, where) == std::memory_order_relaxed) return;
  if (acquire) me().view.join(me().for_acquire_fence);
  if (release) me().at_release_fence = me().view;
}

void Model::access_data(const void* data, bool write) {
  Data& d = data_[data];
  const Clock& known = me().view.clock;
  for (std::size_t i = 0; i < kThreads; ++i)
    if (i != running_ && (d.written[i] > known[i] || (write && d.read[i] > known[i])))
      return fail(write ? "a write races" : "a read races");
  (write ? d.written : d.read)[running_] = ++me().view.clock[running_];
}

}  // namespace rigor::test
