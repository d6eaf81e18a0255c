// Threads that simulators compute on.
//
// The loop must not wait for a picture, and a picture must not depend on which thread made it. So work is
// queued in strands: the jobs of one strand run one after the other, in the order in which they were
// submitted, on whichever thread is free; jobs of different strands run side by side. A source has one
// strand, therefore it computes the same whether the pool has one thread or twenty.
//
//   WorkerPool pool(2);
//   auto strand = pool.make_strand([&] { …take the next request from a ring of my own, and do it… });
//   strand->submit();              // loop thread: wait-free, at most a futex wake
//   strand->wait_for(7);           // virtual time, setup: until seven jobs are done
#pragma once

#include <semaphore.h>

#include <array>
#include <atomic>
#include <condition_variable>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <thread>
#include <vector>

namespace rigor {

class WorkerPool {
 public:
  static constexpr std::size_t kMaxStrands = 128;

  class Strand;

  /// Setup context. `threads` ≥ 1. They run with the default scheduling policy, never above the loop.
  explicit WorkerPool(std::size_t threads);
  /// Strands must be gone by now.
  ~WorkerPool();
  WorkerPool(const WorkerPool&) = delete;
  WorkerPool& operator=(const WorkerPool&) = delete;

  /// Setup context. `job` is called once for each submit, never by two threads at a time, and sees what
  /// earlier calls wrote; it must not throw. Null when kMaxStrands are in use.
  [[nodiscard]] std::unique_ptr<Strand> make_strand(std::function<void()> job);
  [[nodiscard]] std::size_t threads() const noexcept { return threads_.size(); }

 private:
  // A slot outlives the strand that uses it, so that a worker may look at it at any time; `job` is touched
  // only by whoever holds `claimed`.
  struct Slot {
    std::atomic<bool> claimed{false};
    std::atomic<std::uint64_t> submitted{0};
    std::atomic<std::uint64_t> done{0};
    std::function<void()> job;
    bool used = false;  // guarded by setup_
  };

  void work();
  bool run_one(Slot& slot);

  std::array<Slot, kMaxStrands> slots_;
  std::mutex setup_;
  std::mutex done_mutex_;
  std::condition_variable done_;
  sem_t wake_{};
  std::atomic<bool> stopping_{false};
  std::vector<std::thread> threads_;
};

/// The queue of one source. Jobs that were submitted but not begun when it is destroyed are dropped; one that
/// runs is waited for.
class WorkerPool::Strand {
 public:
  ~Strand();
  Strand(const Strand&) = delete;
  Strand& operator=(const Strand&) = delete;

  /// One thread at a time (the loop). Wait-free; wakes a worker.
  void submit() noexcept;
  /// Jobs submitted and not finished. Any thread.
  [[nodiscard]] std::uint64_t backlog() const noexcept;
  [[nodiscard]] std::uint64_t submitted() const noexcept;
  /// Blocks until `count` jobs in all are finished (of those submitted since the strand was made). Not for
  /// the loop in wall time.
  void wait_for(std::uint64_t count);
  void wait_idle() { wait_for(submitted()); }

 private:
  friend class WorkerPool;
  Strand(WorkerPool& pool, Slot& slot) : pool_(pool), slot_(slot) {}
  WorkerPool& pool_;
  Slot& slot_;
};

}  // namespace rigor
