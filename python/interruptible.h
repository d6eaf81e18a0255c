// Long work that Ctrl-C ends: it runs on a thread of its own without the GIL, while the caller's thread
// waits, lets Python handle signals, and says how far the work has come.
#pragma once

#include <pybind11/pybind11.h>
#include <signal.h>

#include <chrono>
#include <condition_variable>
#include <exception>
#include <functional>
#include <mutex>
#include <optional>
#include <thread>
#include <utility>

#include "rt-core/stop.h"

namespace rigor::python {

namespace py = pybind11;

/// A thread that does one piece of work after the other. It must live as long as the processes that its work
/// starts: the kernel ends them with the thread that started them.
class Worker {
 public:
  Worker() : thread_([this] { serve(); }) {}
  ~Worker() {
    {
      const std::scoped_lock lock(mutex_);
      ending_ = true;
    }
    changed_.notify_all();
    thread_.join();
  }
  Worker(const Worker&) = delete;
  Worker& operator=(const Worker&) = delete;

  /// `work` throws nothing.
  void begin(std::function<void()> work) {
    {
      const std::scoped_lock lock(mutex_);
      work_ = std::move(work);
      busy_ = true;
    }
    changed_.notify_all();
  }
  [[nodiscard]] bool ended_within(std::chrono::milliseconds time) {
    std::unique_lock lock(mutex_);
    return changed_.wait_for(lock, time, [this] { return !busy_; });
  }

 private:
  void serve() {
    // Signals are for the threads of Python. Processes inherit the mask, and are ended by SIGTERM.
    sigset_t blocked;
    sigfillset(&blocked);
    sigdelset(&blocked, SIGTERM);
    pthread_sigmask(SIG_BLOCK, &blocked, nullptr);
    std::unique_lock lock(mutex_);
    while (true) {
      changed_.wait(lock, [this] { return work_ || ending_; });
      if (!work_) return;
      const std::function<void()> work = std::exchange(work_, nullptr);
      lock.unlock();
      work();
      lock.lock();
      busy_ = false;
      changed_.notify_all();
    }
  }

  std::mutex mutex_;
  std::condition_variable changed_;
  std::function<void()> work_;
  bool busy_ = false, ending_ = false;
  std::thread thread_;  // after what it uses
};

/// `work(StopToken)` gives a value. `look` is called with the GIL a few times a second while it goes on. What
/// either of them throws, or a handler of a signal raises, asks the work to stop, and is thrown when it has.
template <class Work, class Look>
[[nodiscard]] auto interruptible(Worker& worker, Work&& work, Look&& look) -> decltype(work(StopToken{})) {
  StopSource stop;
  std::optional<decltype(work(StopToken{}))> result;
  std::exception_ptr thrown;
  std::exception_ptr raised;
  {
    const py::gil_scoped_release without_gil;
    worker.begin([&] {
      try {
        result.emplace(work(stop.token()));
      } catch (...) {
        thrown = std::current_exception();
      }
    });
    while (!worker.ended_within(std::chrono::milliseconds(100))) {
      if (raised) continue;
      const py::gil_scoped_acquire gil;
      try {
        if (PyErr_CheckSignals() != 0) throw py::error_already_set();
        look();
      } catch (...) {
        raised = std::current_exception();
        stop.request(StopReason::signal);
      }
    }
  }
  if (raised) std::rethrow_exception(raised);
  if (thrown) std::rethrow_exception(thrown);
  return std::move(*result);
}

/// Work that starts no processes.
template <class Work>
[[nodiscard]] auto interruptible(Work&& work) {
  Worker worker;
  return interruptible(worker, std::forward<Work>(work), [] {});
}

}  // namespace rigor::python
