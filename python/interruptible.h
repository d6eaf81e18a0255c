// Long work that Ctrl-C ends: it runs on a thread of its own without the GIL, while the caller's thread
// waits, lets Python handle signals, and says how far the work has come.
#pragma once

#include <pybind11/pybind11.h>
#include <signal.h>

#include <chrono>
#include <condition_variable>
#include <exception>
#include <mutex>
#include <optional>
#include <thread>
#include <utility>

#include "rt-core/stop.h"

namespace rigor::python {

namespace py = pybind11;

/// `work(StopToken)` gives a value. `look` is called with the GIL a few times a second while it goes on. What
/// either of them throws, or a handler of a signal raises, asks the work to stop, and is thrown when it has.
template <class Work, class Look>
[[nodiscard]] auto interruptible(Work&& work, Look&& look) -> decltype(work(StopToken{})) {
  StopSource stop;
  std::optional<decltype(work(StopToken{}))> result;
  std::exception_ptr thrown;
  std::mutex mutex;
  std::condition_variable ended;
  bool over = false;
  std::exception_ptr raised;
  {
    const py::gil_scoped_release without_gil;
    std::thread thread([&] {
      // Signals are for the threads of Python.
      sigset_t all;
      sigfillset(&all);
      pthread_sigmask(SIG_BLOCK, &all, nullptr);
      try {
        result.emplace(work(stop.token()));
      } catch (...) {
        thrown = std::current_exception();
      }
      const std::scoped_lock lock(mutex);
      over = true;
      ended.notify_one();
    });
    std::unique_lock lock(mutex);
    while (!ended.wait_for(lock, std::chrono::milliseconds(100), [&] { return over; })) {
      if (raised) continue;
      lock.unlock();
      {
        const py::gil_scoped_acquire gil;
        try {
          if (PyErr_CheckSignals() != 0) throw py::error_already_set();
          look();
        } catch (...) {
          raised = std::current_exception();
          stop.request(StopReason::signal);
        }
      }
      lock.lock();
    }
    lock.unlock();
    thread.join();
  }
  if (raised) std::rethrow_exception(raised);
  if (thrown) std::rethrow_exception(thrown);
  return std::move(*result);
}

template <class Work>
[[nodiscard]] auto interruptible(Work&& work) {
  return interruptible(std::forward<Work>(work), [] {});
}

}  // namespace rigor::python
