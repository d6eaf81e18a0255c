// What a worker calls for each pair takes no memory and no lock: baseline, its end, alarm, acknowledgement.
#include <gtest/gtest.h>

#include <cstring>
#include <functional>

#include "rt-core/realtime_guard.h"
#include "rt-core/realtime_scope.h"
#include "sensor-hal/channel/pair_watch/pair_watch.h"
#include "tests/sensor-hal/pair_watch/noise_for_tests.h"

namespace rigor::pair_watch {
namespace {

using Make = std::function<void(Sample&, testing::Random&, bool changed)>;

void run(PairWatch watch, const Make& make) {
  (void)guard::install();  // allocations are seen also where system calls are not
  guard::clear();
  testing::Random random(1);
  Sample real, simulated;
  real.reserve(1 << 16), simulated.reserve(1 << 16);
  for (int i = 0; i < 60; ++i) {
    real.stamp.t_capture = simulated.stamp.t_capture = BenchTime{} + seconds(i);
    make(real, random, i >= 30);
    make(simulated, random, false);
    RealtimeScope scope;
    watch.add(real, simulated);
    const PairWatchSnapshot s = watch.snapshot();
    if (s.alarms == 1) watch.acknowledge();
    if (s.alarms == 3) watch.learn_again();
  }
  EXPECT_GT(watch.snapshot().alarms, 0u);
  const guard::Report report = guard::report();
  EXPECT_EQ(report.allocations + report.locks, 0u) << report.text();
  guard::uninstall();
}

WatchOptions options() {
  WatchOptions o;
  o.window_s = 1, o.baseline_windows = 20;
  return o;
}

TEST(PairWatchAllocation, PicturesTakeNone) {
  CameraModel camera;
  camera.width_px = camera.height_px = 64;
  camera.fx_px = camera.fy_px = 60, camera.cx_px = camera.cy_px = 31.5;
  ImageInfo info;
  info.width_px = info.height_px = 64;
  run(PairWatch::of_images(camera, info, {}, options()).value(),
      [&](Sample& s, testing::Random& r, bool changed) {
        s.info = info, s.size_bytes = 64 * 64;
        for (int i = 0; i < 64 * 64; ++i)
          s.memory()[static_cast<std::size_t>(i)] = static_cast<std::byte>(
              (60 + (i % 64) / 2 + i / 256 + static_cast<int>(3 * r.uniform())) * (changed ? 12 : 10) / 10);
      });
}

TEST(PairWatchAllocation, CloudsTakeNone) {
  run(PairWatch::of_clouds({.points = 1000, .rings = 2, .sigma_m = 0.01}, options()).value(),
      [](Sample& s, testing::Random& r, bool changed) {
        s.info = PointCloudInfo{400}, s.size_bytes = 400 * sizeof(LidarPoint);
        for (int i = 0; i < 400; ++i) {
          const double a = 0.03 * (i / 2), range = 5 + std::sin(a) + (changed ? 0.1 : 0) + 0.01 * r.normal();
          const LidarPoint p{static_cast<float>(range * std::cos(a)),
                             static_cast<float>(range * std::sin(a)),
                             static_cast<float>(0.1 * (i % 2) * range),
                             changed ? 0.7F : 0.5F,
                             i / 2,
                             static_cast<std::uint16_t>(i % 2),
                             0,
                             0};
          std::memcpy(s.memory().data() + static_cast<std::size_t>(i) * sizeof p, &p, sizeof p);
        }
      });
}

TEST(PairWatchAllocation, RangeImagesTakeNone) {
  run(PairWatch::of_range_images({32, 32}, {}, options()).value(),
      [](Sample& s, testing::Random& r, bool changed) {
        s.info = RangeImageInfo{32, 32}, s.size_bytes = 32 * 32 * 8;
        for (std::size_t i = 0; i < 2 * 32 * 32; ++i) {
          const auto v = static_cast<float>(2 + 0.001 * static_cast<double>(i % 1024) + (changed ? 0.1 : 0) +
                                            0.01 * r.normal());
          std::memcpy(s.memory().data() + i * sizeof v, &v, sizeof v);
        }
      });
}

TEST(PairWatchAllocation, NumbersTakeNone) {
  WatchOptions o = options();

  o.window_s = 4;
  o.baseline_windows = 16;
  PairWatch watch = PairWatch::of_numbers(SampleKind::imu, o).value();
  guard::clear();
  (void)guard::install();
  testing::Random random(2);
  for (int i = 0; i < 600; ++i) {
    Sample real, simulated;
    real.stamp.t_capture = BenchTime{} + milliseconds(250 * i);
    ImuSample a, b;
    for (std::size_t k = 0; k < 3; ++k)
      a.angular_rate_radps[k] = random.normal() + (i > 400 ? 20 : 0),
      b.angular_rate_radps[k] = random.normal();
    real.info = a, simulated.info = b;
    RealtimeScope scope;
    watch.add(real, simulated);
  }
  EXPECT_EQ(watch.snapshot().state, WatchState::alarm);
  const guard::Report report = guard::report();
  EXPECT_EQ(report.allocations + report.locks, 0u) << report.text();
  guard::uninstall();
}

}  // namespace
}  // namespace rigor::pair_watch
