// A thread that copies the counters of an emulated camera to the health of its channel.
#pragma once

#include <chrono>
#include <condition_variable>
#include <functional>
#include <mutex>
#include <thread>
#include <utility>

namespace rigor {

/// Calls `copy` at once and every 200 ms, until its end, for which nobody waits longer than one call.
class HealthWatch {
 public:
  explicit HealthWatch(std::function<void()> copy)
      : thread_([this, copy = std::move(copy)](const std::stop_token& stop) {
          std::unique_lock lock(mutex_);
          do copy();
          while (!changed_.wait_for(lock, stop, std::chrono::milliseconds(200),
                                    [&] { return stop.stop_requested(); }));
        }) {}

 private:
  std::mutex mutex_;
  std::condition_variable_any changed_;
  std::jthread thread_;  ///< last: ends before what it waits on
};

}  // namespace rigor
