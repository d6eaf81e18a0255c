// The application as a rig runs it: ports, samples with latencies, a sink that drives a robot; the robot and
// its forest are the test's own.
#pragma once

#include <array>
#include <cstring>
#include <deque>
#include <filesystem>
#include <fstream>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "apps/forest-localization/forest_localization.h"
#include "tests/apps/forest-localization/disc_forest.h"

namespace rigor::forest::test {

/// Counts what the thread allocates while it is watched: defined in test_closed_loop.cpp.
extern thread_local bool watching;
extern thread_local std::size_t allocations;

/// Takes commands and keeps the last.
class FakeSink final : public Sink {
 public:
  explicit FakeSink(std::vector<std::string> names) { description_.names = std::move(names); }
  bool command(const Command& c) noexcept override {
    last = c;
    ++count;
    return true;
  }
  void watch(const Heartbeat*, Duration) override {}
  Command last;
  std::uint64_t count = 0;

 private:
  Status do_configure(const ChannelConfig&) override { return {}; }
  Status do_arm(const ArmContext&) override { return {}; }
  Status do_start(BenchTime) override { return {}; }
  Status do_stop() override { return {}; }
};

/// One channel: samples go in when they are captured and come out when they are due.
struct FakeChannel {
  FakeChannel(SampleKind kind, Duration period, Duration late, std::size_t bytes)
      : latency(late), pool(make_sample_pool(80, bytes)) {
    description.kind = kind;
    port.configure({.period = period, .tolerance = milliseconds(5)}, BenchTime(0));
  }
  template <class T>
  void push(BenchTime t, const T& info, std::span<const LidarPoint> points = {}) {
    SampleSlot slot = pool->try_acquire();
    if (!slot) return;
    Sample& s = *slot;
    s.stamp = {};
    s.stamp.sequence = sequence++;
    s.stamp.t_capture = t;
    s.stamp.t_release = s.stamp.t_arrival = t + latency;
    s.info = info;
    s.size_bytes = std::min(points.size_bytes(), s.memory().size());
    if (s.size_bytes > 0) std::memcpy(s.memory().data(), points.data(), s.size_bytes);
    port.push(std::move(slot));
  }
  ChannelDescription description;
  SamplePort port;
  Duration latency;
  std::unique_ptr<SamplePool> pool;
  std::uint64_t sequence = 0;
};

struct LoopOptions {
  unsigned seed = 1;
  double per_m2 = 0.05;  ///< stems
  bool imu = true;
  double scan_loss = 0;    ///< share of sweeps that never come
  double slips_per_s = 0;  ///< half a second in which one side goes half its way
  double odometry_out_from_s = 1e9, odometry_out_for_s = 0;
  double scans_out_from_s = 1e9, scans_out_for_s = 0;
  double kidnap_at_s = 1e9;
  double nan_share = 0;  ///< of points
  bool with_start = true, with_gnss = false;
  double max_s = 400;
  std::string extra = {};  ///< keys of the application in place of the path
  double map_sigma_m = 0.02;
};

struct LoopResult {
  std::vector<double> error_m, nees;  ///< of each estimate while the robot drives; nees twice a second
  std::vector<double> error_yaw_rad;
  double driven_m = 0, end_error_m = 0, elapsed_s = 0;
  double worst_lost_speed_mps = 0;  ///< commanded while not tracking, from half a second on
  double found_after_s = -1;        ///< kidnapped: until the estimate is within 0.3 m again
  bool done = false;
  std::size_t stops_at_marked = 0;  ///< marked stems before which it stood
  std::size_t allocations = 0;
  PlanarPose end;
  [[nodiscard]] double quantile(double q) const {
    if (error_m.empty()) return 1e9;
    auto e = error_m;
    std::sort(e.begin(), e.end());
    return e[static_cast<std::size_t>(q * static_cast<double>(e.size() - 1))];
  }
};

/// A closed way of about 200 m: a rectangle of 64 by 40 m with rounded corners.
inline std::vector<PlanarPose> way_200() {
  std::vector<PlanarPose> way;
  const double a = 32, b = 20, r = 4;
  const auto corner = [&](double cx, double cy, double from) {
    for (int i = 0; i <= 8; ++i)
      way.push_back({cx + r * std::cos(from + i * kPi / 16), cy + r * std::sin(from + i * kPi / 16), 0});
  };
  way.push_back({-a + r, -b, 0});
  corner(a - r, -b + r, -kPi / 2);
  corner(a - r, b - r, 0);
  corner(-a + r, b - r, kPi / 2);
  corner(-a + r, -b + r, kPi);
  // Points every metre, for the free lane in the forest.
  std::vector<PlanarPose> dense;
  for (std::size_t i = 1; i < way.size(); ++i) {
    const double d = std::hypot(way[i].x_m - way[i - 1].x_m, way[i].y_m - way[i - 1].y_m);
    const int n = std::max(1, static_cast<int>(d));
    for (int k = 0; k < n; ++k)
      dense.push_back({way[i - 1].x_m + (way[i].x_m - way[i - 1].x_m) * k / n,
                       way[i - 1].y_m + (way[i].y_m - way[i - 1].y_m) * k / n, 0});
  }
  dense.push_back(way.back());
  return dense;
}

/// Drives the application through its forest, at a loop of 100 Hz.
LoopResult run_loop(const LoopOptions& options);

/// The application's keys with map and way in `dir`; for tests of its complaints, too.
std::string write_inputs(const std::filesystem::path& dir, const DiscForest& map,
                         const std::vector<PlanarPose>& way, const LoopOptions& options);

}  // namespace rigor::forest::test
