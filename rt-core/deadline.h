// Waiting for an absolute instant on an I/O thread, in a way that stop can cut short.
#pragma once

#include "rt-core/file_descriptor.h"
#include "rt-core/result.h"
#include "rt-core/time.h"

namespace rigor {

/// One waiting thread; `cut` from any other.
class Deadline {
 public:
  [[nodiscard]] Status open();
  /// Sleeps until `t` on CLOCK_MONOTONIC, absolute. False when it was cut short; then, and from then on, at
  /// once.
  [[nodiscard]] bool wait_until(MonotonicTime t) noexcept;
  void cut() noexcept;
  /// Readable once `cut` was called: for threads that also wait for sockets.
  [[nodiscard]] int cut_fd() const noexcept { return event_.get(); }
  /// Setup: makes waits wait again.
  void reset() noexcept;

 private:
  FileDescriptor timer_, event_;
};

}  // namespace rigor
