// What calls of every channel keep to: the order that their state allows, and what the loop's thread must not
// do.
#pragma once

#include <gtest/gtest.h>
#include <sys/resource.h>

#include <algorithm>
#include <filesystem>
#include <iterator>
#include <limits>

#include "sensor-hal/channel/channel.h"

namespace rigor::conformance {

/// What a call did on this thread that the loop must not do: give up the processor, and create threads.
struct CallCost {
  long waits = std::numeric_limits<long>::max();
  std::ptrdiff_t threads = std::numeric_limits<std::ptrdiff_t>::max();

  [[nodiscard]] static CallCost now() {
    rusage usage{};
    getrusage(RUSAGE_THREAD, &usage);
    const std::filesystem::directory_iterator tasks("/proc/self/task");
    return {usage.ru_nvcsw, std::distance(begin(tasks), end(tasks))};
  }
  /// Keeps the lesser: a page of a test's own may be read from disk, a thread of an emulator may come or go.
  void keep_least(const CallCost& before, const CallCost& after) {
    waits = std::min(waits, after.waits - before.waits);
    threads = std::min(threads, std::max<std::ptrdiff_t>(0, after.threads - before.threads));
  }
};

inline void expect_wrong_state(const Status& s, const char* call) {
  ASSERT_FALSE(s) << call << " was allowed";
  EXPECT_EQ(s.error().code, ErrorCode::wrong_state) << call << ": " << s.error().text();
}

}  // namespace rigor::conformance
