#include "sensor-hal/channel/worker_pool.h"

#include <cerrno>
#include <chrono>

#include "rt-core/time_slice.h"

// No wake-up is lost: submit counts first and posts second. A worker that comes for the job and finds the
// strand claimed has by its exchange left a mark in the order of `claimed` before the holder's own exchange
// to false; that one reads it, hence sees the count, and the holder looks at the count once more after giving
// the claim back.
//
// POSIX semaphores and not std::counting_semaphore: that of libstdc++ 12.2 can sleep for ever (GCC bug
// 104928).

namespace rigor {

WorkerPool::WorkerPool(std::size_t threads) {
  sem_init(&wake_, 0, 0);
  if (threads == 0) threads = 1;
  threads_.reserve(threads);
  for (std::size_t i = 0; i < threads; ++i) threads_.emplace_back([this] { work(); });
}

WorkerPool::~WorkerPool() {
  stopping_.store(true, std::memory_order_release);
  for (std::size_t i = 0; i < threads_.size(); ++i) sem_post(&wake_);
  for (auto& thread : threads_) thread.join();
  sem_destroy(&wake_);
}

std::unique_ptr<WorkerPool::Strand> WorkerPool::make_strand(std::function<void()> job) {
  const std::lock_guard lock(setup_);
  for (Slot& slot : slots_) {
    if (slot.used) continue;
    slot.used = true;
    // Nothing is submitted, so no worker looks at `job`; the first submit and its semaphore publish it.
    slot.job = std::move(job);
    return std::unique_ptr<Strand>(new Strand(*this, slot));
  }
  return nullptr;
}

void WorkerPool::work() {
  ask_for_time_slice(kLongTimeSlice);
  while (true) {
    while (sem_wait(&wake_) != 0 && errno == EINTR) {
    }
    if (stopping_.load(std::memory_order_acquire)) return;
    // One job of each strand in turn, so that a slow source does not hold up the others.
    bool found = true;
    while (found && !stopping_.load(std::memory_order_relaxed)) {
      found = false;
      for (Slot& slot : slots_) found = run_one(slot) || found;
    }
  }
}

bool WorkerPool::run_one(Slot& slot) {
  const auto waiting = [&] {
    return slot.submitted.load(std::memory_order_acquire) > slot.done.load(std::memory_order_acquire);
  };
  bool ran = false;
  while (waiting() && !slot.claimed.exchange(true, std::memory_order_acq_rel)) {
    if (waiting()) {
      slot.job();
      {
        const std::lock_guard lock(done_mutex_);
        slot.done.fetch_add(1, std::memory_order_acq_rel);
      }
      done_.notify_all();
      ran = true;
    }
    slot.claimed.exchange(false, std::memory_order_acq_rel);
    if (ran) break;  // the caller comes round again, and looks at the count then
  }
  return ran;
}

WorkerPool::Strand::~Strand() {
  while (slot_.claimed.exchange(true, std::memory_order_acq_rel))
    std::this_thread::sleep_for(std::chrono::microseconds(50));
  slot_.job = nullptr;
  slot_.submitted.store(0, std::memory_order_relaxed);
  slot_.done.store(0, std::memory_order_relaxed);
  slot_.claimed.exchange(false, std::memory_order_acq_rel);
  const std::lock_guard lock(pool_.setup_);
  slot_.used = false;
}

void WorkerPool::Strand::submit() noexcept {
  slot_.submitted.fetch_add(1, std::memory_order_acq_rel);
  sem_post(&pool_.wake_);
}

std::uint64_t WorkerPool::Strand::backlog() const noexcept {
  // `done` first: it never overtakes `submitted`.
  const auto done = slot_.done.load(std::memory_order_acquire);
  return slot_.submitted.load(std::memory_order_acquire) - done;
}

std::uint64_t WorkerPool::Strand::submitted() const noexcept {
  return slot_.submitted.load(std::memory_order_acquire);
}

void WorkerPool::Strand::wait_for(std::uint64_t count) {
  std::unique_lock lock(pool_.done_mutex_);
  pool_.done_.wait(lock, [&] { return slot_.done.load(std::memory_order_acquire) >= count; });
}

}  // namespace rigor
