// Where "now in the real-time loop" is said, so that a test build can watch over it.
//
// The executive opens a RealtimeScope around its loop and a RealtimeSleep around its own sleep. Without the
// guard (rt-core/realtime_guard.h, linked by tests only) both are one load of a null pointer.
#pragma once

#include <atomic>

namespace rigor {

struct RealtimeHooks {
  void (*enter)() noexcept;
  void (*leave)() noexcept;
};
inline constinit std::atomic<const RealtimeHooks*> realtime_hooks{nullptr};

/// From here to the end of the block this thread may not allocate, lock, fault or call what may block.
class RealtimeScope {
 public:
  RealtimeScope() noexcept : hooks_(realtime_hooks.load(std::memory_order_acquire)) {
    if (hooks_) hooks_->enter();
  }
  ~RealtimeScope() {
    if (hooks_) hooks_->leave();
  }
  RealtimeScope(const RealtimeScope&) = delete;
  RealtimeScope& operator=(const RealtimeScope&) = delete;

 private:
  friend class RealtimeSleep;
  const RealtimeHooks* hooks_;
};

/// Within a RealtimeScope: the executive's own sleep, the one blocking call there is.
class RealtimeSleep {
 public:
  explicit RealtimeSleep(const RealtimeScope& scope) noexcept : hooks_(scope.hooks_) {
    if (hooks_) hooks_->leave();
  }
  ~RealtimeSleep() {
    if (hooks_) hooks_->enter();
  }
  RealtimeSleep(const RealtimeSleep&) = delete;
  RealtimeSleep& operator=(const RealtimeSleep&) = delete;

 private:
  const RealtimeHooks* hooks_;
};

}  // namespace rigor
