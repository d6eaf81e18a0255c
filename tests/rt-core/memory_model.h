// All executions of two or three threads that share atomics, with the stale reads that release and acquire
// leave open: what a test instantiates a lock-free type with in place of std::atomic.
//
//   Model model;
//   const Outcome o = model.explore([](Model& m) {
//     auto flag = std::make_shared<ModelAtomic<int>>(0);
//     auto data = std::make_shared<ModelData>();
//     m.thread([=] { data->write(); flag->store(1, std::memory_order_release); });
//     m.thread([=] { if (flag->load(std::memory_order_acquire)) data->read(); });
//   });
//
// The model. Each atomic has a list of stores, in the order in which they were executed. A thread knows of
// each atomic a store that it reads no earlier one than (its view), and of each thread how much of that
// happened before (its clock). A load reads any store from the view on; an acquire takes over the view and
// the clock that a release left in the store, fences likewise. A read-modify-write reads the last store and
// carries its release on. Accesses to ModelData that no such chain orders are a data race, also the end of an
// atomic that another thread has not visibly finished with. Not in the model: a store that is ordered before
// one which was executed earlier, loads that see stores of their own future, and one total order of
// memory_order_seq_cst, which none of the types uses.
//
// Threads are coroutines on one thread. They are switched where one is about to access an atomic that
// another one writes: where no other writes it, sooner and later are the same. The search is depth first
// over the choices of thread and of store, from the start again for each execution.
#pragma once

#include <ucontext.h>

#include <array>
#include <atomic>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <source_location>
#include <string>
#include <utility>
#include <vector>

namespace rigor::test {

/// A place in the source that has a memory order: file and line, column where several stand in a line.
using Site = std::string;

/// One order in place of another.
struct Weakened {
  Site site{};
  std::memory_order order = std::memory_order_relaxed;
};

struct Outcome {
  std::uint64_t executions = 0;
  std::string failure;                      ///< of the first execution that fails; empty: none
  std::map<Site, std::memory_order> sites;  ///< those with more than relaxed
};

class Model {
 public:
  static constexpr std::size_t kThreads = 4;  ///< the setup is one of them
  using Clock = std::array<std::uint32_t, kThreads>;
  /// What one thread knows, or what a store tells: of each atomic the number of a store, of each thread a
  /// count of its steps.
  struct View {
    std::vector<std::uint32_t> store;
    Clock clock{};
    void join(const View& o);
  };

  static Model& current() { return *current_; }

  /// Runs `setup`, then the threads that it began, in all ways; stops at the first failure.
  Outcome explore(const std::function<void(Model&)>& setup, const Weakened& weakened = {});
  /// Setup: one more thread. After `max_accesses` to atomics the execution does not count: it waits in vain.
  void thread(std::function<void()> body, std::uint32_t max_accesses = 1000);
  /// Setup: runs after all threads have ended, and sees all that they did.
  void after(std::function<void()> body) { after_ = std::move(body); }
  void fail(const std::string& what);
  void check(bool holds, const char* what) {
    if (!holds) fail(what);
  }
  // Of the atomics and data.
  std::size_t new_atomic(std::uint64_t value);
  void end_atomic(std::size_t atomic);
  std::uint64_t load(std::size_t atomic, std::memory_order order, const std::source_location& where);
  void store(std::size_t atomic, std::uint64_t value, std::memory_order order,
             const std::source_location& where);
  std::uint64_t modify(std::size_t atomic, const std::function<std::uint64_t(std::uint64_t)>& change,
                       std::memory_order order, const std::source_location& where);
  void fence(bool acquire, bool release, const std::source_location& where);
  void access_data(const void* data, bool write);

 private:
  struct Store {
    std::uint64_t value = 0;
    View told;
  };
  struct Location {
    std::vector<Store> stores;
    Clock accessed{};
  };
  struct Data {
    Clock written{}, read{};
  };
  struct Thread {
    ucontext_t context{};
    std::function<void()> body;
    View view, at_release_fence, for_acquire_fence;
    std::uint32_t accesses_left = 1000;
    bool ended = false;
  };
  struct Choice {
    std::size_t taken = 0, count = 0;
  };
  static void trampoline();
  void give_up();
  void run_once(const std::function<void(Model&)>& setup);
  std::size_t choose(std::size_t count);
  void maybe_switch(std::size_t atomic, bool writes);
  void yield_to_scheduler();
  [[nodiscard]] std::memory_order order_at(std::memory_order order, const std::source_location& where);
  void step(std::size_t atomic);
  void acquire(const View& told, std::memory_order order);
  [[nodiscard]] View told_by(std::memory_order order, std::size_t atomic);
  Thread& me() { return threads_[running_]; }

  static Model* current_;
  // of an exploration
  Outcome outcome_;
  Weakened weakened_;
  std::vector<Choice> choices_;
  std::vector<unsigned> writers_;  ///< of each atomic, a bit for each thread; grows from run to run
  bool writers_grew_ = false;
  // of an execution
  std::size_t depth_ = 0, running_ = 0;
  bool over_ = false;
  std::vector<Thread> threads_;
  std::vector<Location> locations_;
  std::map<const void*, Data> data_;
  std::function<void()> after_;
  ucontext_t scheduler_{};
  std::vector<std::unique_ptr<std::array<char, 64 << 10>>> stacks_;
};

/// In the place of std::atomic.
template <class T>
class ModelAtomic {
  using Where = std::source_location;

 public:
  ModelAtomic(T value = T{}) : number_(Model::current().new_atomic(static_cast<std::uint64_t>(value))) {}
  ~ModelAtomic() { Model::current().end_atomic(number_); }
  ModelAtomic(const ModelAtomic&) = delete;
  ModelAtomic& operator=(const ModelAtomic&) = delete;
  T load(std::memory_order order, Where where = Where::current()) const {
    return static_cast<T>(Model::current().load(number_, order, where));
  }
  void store(T value, std::memory_order order, Where where = Where::current()) {
    Model::current().store(number_, static_cast<std::uint64_t>(value), order, where);
  }
  T fetch_add(T by, std::memory_order order, Where where = Where::current()) {
    return change([by](T x) { return static_cast<T>(x + by); }, order, where);
  }
  T fetch_sub(T by, std::memory_order order, Where where = Where::current()) {
    return change([by](T x) { return static_cast<T>(x - by); }, order, where);
  }
  T fetch_or(T bits, std::memory_order order, Where where = Where::current()) {
    return change([bits](T x) { return static_cast<T>(x | bits); }, order, where);
  }

 private:
  template <class F>
  T change(const F& f, std::memory_order order, const Where& where) {
    return static_cast<T>(Model::current().modify(
        number_, [&f](std::uint64_t x) { return static_cast<std::uint64_t>(f(static_cast<T>(x))); }, order,
        where));
  }
  std::size_t number_;
};

/// Memory that is not atomic: two accesses, one of them a write, must be ordered. Its making and its end are
/// writes, and so is what is made later in its place.
class ModelData {
 public:
  ModelData() { write(); }
  ~ModelData() { write(); }
  ModelData(const ModelData&) = delete;
  ModelData& operator=(const ModelData&) = delete;
  void read() const { Model::current().access_data(this, false); }
  void write() { Model::current().access_data(this, true); }
};

}  // namespace rigor::test
