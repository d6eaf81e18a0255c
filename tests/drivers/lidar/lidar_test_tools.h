// What tests of packet LiDARs share: configurations of their channels, points of samples, runs in virtual
// time and polling on the wall clock.
#pragma once

#include <gtest/gtest.h>

#include <chrono>
#include <cmath>
#include <cstring>
#include <span>
#include <string>
#include <thread>
#include <vector>

#include "sensor-hal/channel/channel.h"
#include "sensor-hal/models/lidar/lidar_model.h"
#include "tests/sensor-hal/channel/test_sources.h"

namespace rigor::packet_lidar::test {

[[nodiscard]] inline ChannelConfig channel_config(const std::string& params, SampleKind kind, Duration period,
                                                  Duration latency) {
  ChannelConfig c = rigor::test::image_config(params, period, latency, "top");
  c.kind = kind;
  return c;
}

[[nodiscard]] inline std::vector<LidarPoint> points_of(const SampleLease& s) {
  std::vector<LidarPoint> p(s->size_bytes / sizeof(LidarPoint));
  std::memcpy(p.data(), s->bytes().data(), s->size_bytes);
  return p;
}

/// Of a simulated LiDAR: the points that it captures.
inline void store_points(std::span<const LidarPoint> points, Sample& sample) {
  std::memcpy(sample.memory().data(), points.data(), points.size_bytes());
  sample.info = PointCloudInfo{static_cast<std::uint32_t>(points.size())};
  sample.size_bytes = points.size_bytes();
}

/// A return at `range_m` along a beam's aim.
[[nodiscard]] inline LidarPoint point_at(const models::LidarAim& aim, double range_m, double remission,
                                         double t_s, std::size_t ring, std::uint8_t return_index) {
  const auto at = [&](std::size_t axis) {
    return static_cast<float>(aim.origin_m[axis] + range_m * aim.direction[axis]);
  };
  return {at(0),
          at(1),
          at(2),
          static_cast<float>(remission),
          static_cast<std::int32_t>(std::lround(t_s * 1e9)),
          static_cast<std::uint16_t>(ring),
          return_index,
          0};
}

/// What a source gives in a run of `time` in virtual time.
[[nodiscard]] inline std::vector<SampleLease> run_virtual(Source& source, const ChannelConfig& config,
                                                          Duration time) {
  auto s = source.configure(config);
  EXPECT_TRUE(s) << s.error().text();
  ArmContext context;
  context.virtual_time = true;
  s = source.arm(context);
  EXPECT_TRUE(s) << s.error().text();
  EXPECT_TRUE(source.start(BenchTime(0)));
  std::vector<SampleLease> got;
  for (BenchTime now(0); now <= BenchTime(0) + time; now = now + milliseconds(1)) {
    source.complete_until(now);
    while (SampleLease l = source.poll(now)) got.push_back(std::move(l));
  }
  return got;
}

/// Polls until `done`, or half a minute has passed.
template <class Done>
bool poll_until(Source& source, std::vector<SampleLease>& got, Done&& done) {
  for (const MonotonicTime end = monotonic_now() + seconds(30); !done() && monotonic_now() < end;) {
    while (SampleLease s = source.poll(bench_now())) {
      EXPECT_LE(s->stamp.t_capture.ns(), monotonic_now().ns());
      got.push_back(std::move(s));
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(2));  // the pace of polling
  }
  return done();
}

/// That samples are numbered without a gap that `lost_before` does not explain, each later than the one
/// before.
inline void expect_numbered(const std::vector<SampleLease>& got) {
  for (std::size_t i = 1; i < got.size(); ++i) {
    EXPECT_EQ(got[i]->stamp.sequence, got[i - 1]->stamp.sequence + 1 + got[i]->stamp.lost_before);
    EXPECT_GT(got[i]->stamp.t_capture, got[i - 1]->stamp.t_capture);
  }
}

/// A running source whose device goes, is silent for more than a second, and comes again. Gives the samples,
/// and the first of them that came after that.
template <class Go, class Come>
std::size_t expect_survival(Source& source, std::vector<SampleLease>& got, Go&& go, Come&& come) {
  EXPECT_TRUE(poll_until(source, got, [&] { return got.size() >= 3; }));
  EXPECT_TRUE(go());
  EXPECT_TRUE(poll_until(source, got, [&] { return !source.health().connected; }));
  const std::size_t before = got.size();
  EXPECT_TRUE(come());
  EXPECT_TRUE(poll_until(source, got, [&] { return got.size() >= before + 3; }));
  EXPECT_TRUE(source.health().connected);
  EXPECT_GE(source.health().reconnects, 1u);
  expect_numbered(got);
  // A last sample may have been on its way when the device went.
  std::uint64_t lost = 0;
  for (std::size_t i = before; i < got.size(); ++i) lost += got[i]->stamp.lost_before;
  EXPECT_GE(lost, 1u);
  return before;
}

}  // namespace rigor::packet_lidar::test
