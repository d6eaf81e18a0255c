// A pair under watch in a test: windows in, the alarm out.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdio>
#include <cstring>
#include <string>

#include "sensor-hal/channel/pair_watch/change_watch.h"

namespace rigor::pair_watch::testing {

/// 600 s of baseline, one false alarm in 1000 h.
inline WatchOptions watch_options(std::uint32_t baseline = 200) {
  WatchOptions o;
  o.window_s = 10, o.baseline_windows = baseline, o.false_alarms_per_h = 1e-3;
  return o;
}

inline std::string told(const ChangeWatch& watch) {
  const Alarm& a = watch.alarm();
  const Parameter &p = watch.parameters()[a.parameter], &q = watch.parameters()[a.runner_up];
  char text[300];
  std::snprintf(text, sizeof text, "%s: %.4g ± %.2g %s (log ratio %.1f; next %s, %.1f)", p.name.c_str(),
                a.change, a.sigma, p.unit.c_str(), a.log_ratio, q.name.c_str(), a.runner_up_log_ratio);
  return text;
}

/// Learns, watches `quiet` windows without a change, then with: how many until the alarm; 0: none came.
template <class Window>
int windows_to_alarm(ChangeWatch& watch, Window window, int learn, int quiet, int most = 200) {
  for (int i = 0; i < learn + quiet; ++i) watch.add(window(false));
  if (watch.state() != WatchState::watching) {
    ADD_FAILURE() << "alarm before the change: " << told(watch);
    return 0;
  }
  for (int i = 1; i <= most; ++i) {
    watch.add(window(true));
    if (watch.state() == WatchState::alarm) {
      std::printf("  %d windows: %s\n", i, told(watch).c_str());
      ::testing::Test::RecordProperty("windows_to_alarm", i);
      return i;
    }
  }
  return 0;
}

/// Learns, then watches 10 000 windows without a change: fails at an alarm, and where the sums did not live.
template <class Window>
void expect_no_false_alarm(ChangeWatch& watch, Window window, int learn) {
  double highest = 0;
  for (int i = 0; i < learn + 10000; ++i) {
    watch.add(window(false));
    ASSERT_NE(watch.state(), WatchState::alarm) << i << ": " << told(watch);
    for (std::size_t k = 0; k < watch.parameters().size(); ++k)
      highest = std::max(highest, watch.parameter_state(k).level);
  }
  EXPECT_GT(highest, 0.2);
  std::printf("  highest sum: %.2f of its threshold\n", highest);
}

inline std::string name_of_alarm(const ChangeWatch& watch) {
  return watch.state() == WatchState::alarm ? watch.parameters()[watch.alarm().parameter].name : "none";
}

template <class T>
void fill(Sample& s, std::span<const T> values) {
  s.size_bytes = values.size_bytes();
  std::memcpy(s.memory().data(), values.data(), s.size_bytes);
}

}  // namespace rigor::pair_watch::testing
