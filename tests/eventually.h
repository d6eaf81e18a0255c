// Waiting for what another thread or program brings about.
#pragma once

#include <functional>
#include <thread>

#include "rt-core/time.h"

namespace rigor::test {

/// True as soon as `what` holds. The limit is for machines that are busy; only a broken program meets it.
inline bool eventually(const std::function<bool()>& what, Duration limit = seconds(20)) {
  for (const MonotonicTime end = monotonic_now() + limit; !what();) {
    if (monotonic_now() > end) return what();
    std::this_thread::sleep_for(std::chrono::milliseconds(1));  // the pace of asking
  }
  return true;
}

}  // namespace rigor::test
