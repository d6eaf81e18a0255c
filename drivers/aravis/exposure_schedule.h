// When a camera's sensor exposes: free running on a grid, by software trigger, or by pulses on its line.
//
//   schedule.start(now);
//   while (schedule.next() <= now) {
//     const auto e = schedule.begin(now, exposure_time);      // one exposure, its instant and number
//   }
//
// Free-running instants lie on a grid of whole numbers and do not drift. What lies a period or more behind
// `now` is skipped and counted. A pulse that comes while the sensor is busy is missed; a software trigger
// waits. No thread, no clock; one caller at a time.
#pragma once

#include <cstdint>
#include <deque>
#include <optional>

#include "rt-core/period.h"
#include "rt-core/time.h"

namespace rigor {

class ExposureSchedule {
 public:
  enum class Trigger : std::uint8_t { free_run, software, line };
  struct Settings {
    Trigger trigger = Trigger::free_run;
    Period period;   ///< of free running
    Duration delay;  ///< from a trigger to the exposure
    bool falling_edge = false;
    bool operator==(const Settings& o) const {
      return trigger == o.trigger && period.same_as(o.period) && delay == o.delay &&
             falling_edge == o.falling_edge;
    }
  };
  /// What is wired to the line: it rises at phase + k·period and falls half a period later. Period 0:
  /// nothing.
  struct Line {
    Period period;
    Duration phase;
  };
  struct Exposure {
    std::uint64_t index = 0;  ///< since start(), skipped ones included
    DeviceTime start;
  };
  struct Counters {
    std::uint64_t skipped = 0, triggers = 0, triggers_refused = 0, line_edges = 0, line_missed = 0;
  };

  /// `on_clock`: free-running instants are multiples of the period on the clock, not counted from start().
  ExposureSchedule(bool on_clock, const Line& line) : on_clock_(on_clock), line_(line) {}

  void start(DeviceTime now);
  void stop();
  /// A change keeps the exposure in progress; triggers that wait are dropped where their source changes.
  void set(const Settings& settings, DeviceTime now);
  [[nodiscard]] const Settings& settings() const { return settings_; }
  /// False: not started, not the trigger that is chosen, or too many wait.
  [[nodiscard]] bool software_trigger(DeviceTime now);
  [[nodiscard]] bool line_is_high(DeviceTime now) const;
  /// Of the next exposure, or never().
  [[nodiscard]] DeviceTime next() const;
  /// The exposure that is due at or before `now`; empty where none is.
  [[nodiscard]] std::optional<Exposure> begin(DeviceTime now, Duration exposure);
  [[nodiscard]] const Counters& counters() const { return counters_; }

 private:
  void run_freely_from(DeviceTime t);
  [[nodiscard]] DeviceTime grid(std::int64_t k) const { return zero_ + settings_.period * k; }
  [[nodiscard]] DeviceTime edge(std::int64_t k) const;
  /// The first edge at or after `t`.
  [[nodiscard]] std::int64_t edge_from(DeviceTime t) const;

  bool on_clock_;
  Line line_;
  Settings settings_;
  bool running_ = false;
  std::uint64_t index_ = 0;
  DeviceTime zero_;             ///< of the free-running grid
  std::int64_t next_grid_ = 0;  ///< index of the next free-running exposure
  std::int64_t next_edge_ = 0;
  DeviceTime sensor_free_;
  std::deque<DeviceTime> triggers_;
  Counters counters_;
};

}  // namespace rigor
