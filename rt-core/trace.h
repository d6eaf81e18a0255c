// What happened when, for https://ui.perfetto.dev: spans, instants and counters, per thread.
//
//   Trace trace;                                       // setup
//   const auto name = trace.name("grab");
//   TraceThread& t = trace.thread("camera left", 1 << 16);   // all memory now
//   t.begin(name); ... t.end(name);                    // that thread; real-time
//   trace.write("run.trace.json");                     // afterwards
//
// A full buffer drops what comes, counted, and never half of a span. With RIGOR_TRACE=0 all recording
// compiles to nothing.
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "rt-core/result.h"
#include "rt-core/time.h"

#ifndef RIGOR_TRACE
#define RIGOR_TRACE 1
#endif

namespace rigor {

using TraceName = std::uint32_t;

/// The buffer of one thread. Recording: that thread only; wait-free, no allocation.
class TraceThread {
 public:
  void begin(TraceName name) noexcept { begin_at(name, monotonic_now().ns()); }
  void end(TraceName name) noexcept { end_at(name, monotonic_now().ns()); }
  void instant(TraceName name) noexcept { single(Kind::instant, name, monotonic_now().ns(), 0); }
  void counter(TraceName name, double value) noexcept {
    single(Kind::counter, name, monotonic_now().ns(), value);
  }
  /// With times that were measured anyway; ns of the bench clock.
  void begin_at(TraceName name, std::int64_t t_ns) noexcept;
  void end_at(TraceName name, std::int64_t t_ns) noexcept;
  void instant_at(TraceName name, std::int64_t t_ns) noexcept { single(Kind::instant, name, t_ns, 0); }
  void counter_at(TraceName name, std::int64_t t_ns, double value) noexcept {
    single(Kind::counter, name, t_ns, value);
  }

  /// Any thread.
  [[nodiscard]] std::size_t recorded() const noexcept { return count_.load(std::memory_order_acquire); }
  [[nodiscard]] std::uint64_t dropped() const noexcept { return dropped_.load(std::memory_order_relaxed); }
  /// ns of the bench clock; no meaning while nothing was dropped.
  [[nodiscard]] std::int64_t first_dropped_ns() const noexcept {
    return first_dropped_ns_.load(std::memory_order_relaxed);
  }

 private:
  friend class Trace;
  enum class Kind : std::uint8_t { begin, end, instant, counter };
  struct Event {
    std::int64_t t_ns;
    double value;
    TraceName name;
    Kind kind;
  };
  TraceThread(std::string name, std::size_t capacity, std::uint32_t id);
  void single(Kind kind, TraceName name, std::int64_t t_ns, double value) noexcept;
  void push(const Event& e) noexcept {
    const std::size_t n = count_.load(std::memory_order_relaxed);
    events_[n] = e;
    count_.store(n + 1, std::memory_order_release);
  }
  void drop(std::int64_t t_ns) noexcept {
    if (dropped_.load(std::memory_order_relaxed) == 0)
      first_dropped_ns_.store(t_ns, std::memory_order_relaxed);
    dropped_.store(dropped_.load(std::memory_order_relaxed) + 1, std::memory_order_relaxed);
  }

  std::string name_;
  std::uint32_t id_;
  std::size_t capacity_;
  std::unique_ptr<Event[]> events_;
  std::atomic<std::size_t> count_{0};
  std::atomic<std::uint64_t> dropped_{0};
  std::atomic<std::int64_t> first_dropped_ns_{0};
  std::size_t open_ = 0;          // spans begun: room for their ends is kept
  std::size_t dropped_open_ = 0;  // spans whose begin was dropped
};

/// Setup: any thread. The trace outlives the threads that record into it.
class Trace {
 public:
  Trace() = default;
  /// The number of a name; the same for the same name.
  [[nodiscard]] TraceName name(const std::string& text);
  /// A new buffer of `capacity` events (32 bytes each), its memory touched.
  [[nodiscard]] TraceThread& thread(const std::string& name, std::size_t capacity = std::size_t{1} << 16);

  /// Chrome's JSON trace format, as Perfetto opens it; one event a line, sorted by thread. May be called
  /// while threads record: it writes what was complete then. not_writable, disk_full, io.
  [[nodiscard]] Status write(const std::string& path) const;
  [[nodiscard]] std::uint64_t dropped() const;
  /// From when on events are missing, on the bench clock; none: nothing was dropped.
  [[nodiscard]] std::optional<std::int64_t> full_since_ns() const;

 private:
  mutable std::mutex mutex_;
  std::vector<std::string> names_;
  std::vector<std::unique_ptr<TraceThread>> threads_;
};

inline void TraceThread::begin_at(TraceName name, std::int64_t t_ns) noexcept {
#if RIGOR_TRACE
  // Room for this event, for its end, and for the ends of the spans that are open.
  if (dropped_open_ > 0 || count_.load(std::memory_order_relaxed) + open_ + 2 > capacity_) {
    ++dropped_open_;
    drop(t_ns);
    return;
  }
  ++open_;
  push({t_ns, 0, name, Kind::begin});
#else
  (void)name, (void)t_ns;
#endif
}

inline void TraceThread::end_at(TraceName name, std::int64_t t_ns) noexcept {
#if RIGOR_TRACE
  if (dropped_open_ > 0) {
    --dropped_open_;
    drop(t_ns);
  } else if (open_ > 0) {  // an end without a begin has no meaning, and would take a reserved place
    --open_;
    push({t_ns, 0, name, Kind::end});
  } else {
    drop(t_ns);
  }
#else
  (void)name, (void)t_ns;
#endif
}

inline void TraceThread::single(Kind kind, TraceName name, std::int64_t t_ns, double value) noexcept {
#if RIGOR_TRACE
  if (count_.load(std::memory_order_relaxed) + open_ + 1 > capacity_) {
    drop(t_ns);
    return;
  }
  push({t_ns, value, name, kind});
#else
  (void)kind, (void)name, (void)t_ns, (void)value;
#endif
}

}  // namespace rigor
