// Every kind of fault, on what it fits: what it does, and that every sample is accounted for.
#include <cmath>
#include <random>
#include <set>

#include "tests/sensor-hal/channel/fault_fixture.h"

namespace rigor::test {
namespace {

using ::testing::AllOf;
using ::testing::Each;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

constexpr SampleKind kRegisters = SampleKind::register_block;

TEST(Fault, WithoutFaultsEverySampleIsHandedOnAsItCame) {
  FaultRun run(kRegisters, "");
  ASSERT_TRUE(run.status) << run.status.error().text();
  run.until(seconds(1));
  ASSERT_EQ(run.seen.size(), 100u);
  for (std::size_t i = 0; i < 100; ++i) {
    EXPECT_EQ(run.seen[i].stamp.sequence, i);
    EXPECT_EQ(run.seen[i].at, run.seen[i].stamp.t_release);
    EXPECT_EQ(run.seen[i].stamp.validity, kValid);
  }
  run.expect_accounted();
  EXPECT_TRUE(run.events.empty());
}

TEST(Fault, DropLosesItsShareAndTheNextSampleSaysSo) {
  FaultRun run(kRegisters, "{kind: drop, probability: 0.2}");
  ASSERT_TRUE(run.status) << run.status.error().text();
  run.until(seconds(50));
  const auto& a = run.source.accounts();
  // 5000 draws at 0.2: sigma is 28.
  EXPECT_NEAR(static_cast<double>(a.dropped), 1000, 5 * 28.3);
  EXPECT_EQ(a.dropped, run.fault(0).count.dropped);
  EXPECT_EQ(run.fault(0).count.seen, 5000u);
  run.expect_accounted();
  std::uint64_t said = 0;
  for (const Seen& s : run.seen) said += s.stamp.lost_before;
  EXPECT_NEAR(static_cast<double>(said), static_cast<double>(a.dropped), 5);
  EXPECT_EQ(run.port.counters().lost_samples, said);
  EXPECT_EQ(run.source.health().lost, a.dropped);
}

TEST(Fault, BurstLossHasTheStatedShareAndMeanLength) {
  FaultRun run(kRegisters, "{kind: burst_loss, share: 0.25, mean_burst: 8}");
  ASSERT_TRUE(run.status) << run.status.error().text();
  run.until(seconds(400));
  std::size_t bursts = 0, lost = 0;
  std::uint64_t expected = 0;
  for (const std::uint64_t k : run.sequences()) {
    bursts += k > expected;
    lost += k - expected;
    expected = k + 1;
  }
  ASSERT_GT(bursts, 100u);
  // Lengths are geometric with sigma 7.5, some 1250 of them; cycles of 32 samples.
  EXPECT_NEAR(static_cast<double>(lost) / static_cast<double>(bursts), 8, 5 * 7.5 / std::sqrt(1250));
  EXPECT_NEAR(static_cast<double>(lost) / 40000, 0.25, 0.04);
  run.expect_accounted();
}

TEST(Fault, DelayMakesThePortLateAndKeepsTheOrder) {
  FaultRun run(kRegisters, "{kind: delay, delay_ms: 25, from_s: 1, until_s: 2}");
  ASSERT_TRUE(run.status) << run.status.error().text();
  run.until(seconds(3));
  run.expect_accounted();
  EXPECT_EQ(run.seen.size(), 300u);
  for (const Seen& s : run.seen) {
    const Duration behind = s.at - s.stamp.t_release;
    EXPECT_EQ(s.stamp.t_arrival - s.stamp.t_release, behind);
    const bool on =
        s.stamp.t_release >= BenchTime(0) + seconds(1) && s.stamp.t_release < BenchTime(0) + seconds(2);
    // Those just after it wait behind the last delayed ones.
    if (on || s.stamp.t_release > BenchTime(0) + milliseconds(2030)) {
      EXPECT_EQ(behind, on ? milliseconds(25) : Duration(0)) << s.stamp.sequence;
    }
  }
  EXPECT_TRUE(run.showed(PortStatus::late, milliseconds(1005), milliseconds(1100)));
  EXPECT_FALSE(run.showed(PortStatus::late, milliseconds(0), seconds(1)));
  EXPECT_FALSE(run.showed(PortStatus::late, milliseconds(2100), seconds(3)));
  EXPECT_GE(run.fault(0).count.delayed, 99u);
  EXPECT_GE(run.port.counters().late_samples, 99u);
}

TEST(Fault, JitterHasTheStatedDistribution) {
  struct Case {
    const char* keys;
    double mean_ms, sigma_ms;
  };
  for (const Case& c : {Case{"shape: uniform, min_ms: 1, max_ms: 7", 4, 6 / std::sqrt(12)},
                        Case{"shape: exponential, mean_ms: 1", 1, 1},
                        Case{"shape: normal, mean_ms: 4, sigma_ms: 0.5", 4, 0.5}}) {
    FaultRun run(kRegisters, std::string("{kind: jitter, ") + c.keys + "}");
    ASSERT_TRUE(run.status) << run.status.error().text();
    run.until(seconds(40));
    double sum = 0, squares = 0, n = 0;
    for (const Seen& s : run.seen) {
      const double d_ms = (s.stamp.t_arrival - s.stamp.t_release).seconds() * 1e3;
      EXPECT_GE(d_ms, 0);
      sum += d_ms, squares += d_ms * d_ms, n += 1;
    }
    const double mean = sum / n, sigma = std::sqrt(squares / n - mean * mean);
    EXPECT_NEAR(mean, c.mean_ms, 5 * c.sigma_ms / std::sqrt(n)) << c.keys;
    // The fourth moment of an exponential is nine times its variance squared.
    EXPECT_NEAR(sigma, c.sigma_ms, 5 * c.sigma_ms * std::sqrt(8 / (4 * n))) << c.keys;
    run.expect_accounted();
  }
}

TEST(Fault, StuckRepeatsTheFirstValueWithNewStampsOrWithTheOldOne) {
  for (const bool freeze : {false, true}) {
    FaultRun run(kRegisters, std::string("{kind: stuck, from_s: 1, until_s: 2, freeze: ") +
                                 (freeze ? "true}" : "false}"));
    ASSERT_TRUE(run.status) << run.status.error().text();
    run.until(seconds(3));
    ASSERT_EQ(run.seen.size(), 300u);
    const auto a = run.values(0);
    double frozen = -1;
    for (const Seen& s : run.seen) {
      const auto k = static_cast<double>(s.stamp.sequence);
      const double v = a[s.stamp.sequence];
      if (s.at < BenchTime(0) + seconds(1) || s.at >= BenchTime(0) + seconds(2)) {
        EXPECT_EQ(v, k);
        continue;
      }
      if (frozen < 0) frozen = v;
      EXPECT_EQ(v, frozen);
      const auto t = BenchTime(0) + milliseconds(10) * static_cast<std::int64_t>(freeze ? frozen : k);
      EXPECT_EQ(s.stamp.t_capture, t);
    }
    EXPECT_EQ(frozen, 100);
    EXPECT_EQ(run.fault(0).count.changed, 99u);
    run.expect_accounted();
  }
}

TEST(Fault, BiasDriftNoiseAndSpikeChangeOneRegisterInItsUnit) {
  FaultRun bias(kRegisters, "{kind: bias, value: b, amount: 2.5, from_s: 0.5}");
  bias.until(seconds(1));
  EXPECT_THAT(bias.values(0), ::testing::Contains(99.0));
  EXPECT_EQ(bias.values(1).front(), 100);
  EXPECT_EQ(bias.values(1).back(), 102.5);

  FaultRun drift(kRegisters, "{kind: drift, value: b, rate_per_s: -3, from_s: 1}");
  drift.until(seconds(3));
  const Seen& last = drift.seen.back();
  EXPECT_NEAR(drift.values(1).back(),
              100 - 3 * (last.stamp.t_capture - (BenchTime(0) + seconds(1))).seconds(), 1e-9);

  FaultRun noise(kRegisters, "{kind: noise, value: b, sigma: 0.5}");
  noise.until(seconds(40));
  double sum = 0, squares = 0;
  for (const double v : noise.values(1)) sum += v - 100, squares += (v - 100) * (v - 100);
  const auto n = static_cast<double>(noise.seen.size());
  EXPECT_NEAR(sum / n, 0, 5 * 0.5 / std::sqrt(n));
  EXPECT_NEAR(std::sqrt(squares / n), 0.5, 5 * 0.5 / std::sqrt(2 * n));
  EXPECT_EQ(noise.fault(0).count.changed, noise.seen.size());

  // Two faults of one channel do not draw the same.
  FaultRun twice(kRegisters, "{kind: noise, value: b, sigma: 0.5}, {kind: noise, value: b, sigma: 0.5}");
  twice.until(seconds(40));
  squares = 0;
  for (const double v : twice.values(1)) squares += (v - 100) * (v - 100);
  EXPECT_NEAR(squares / n, 0.5, 5 * 0.5 * std::sqrt(2 / n));

  FaultRun spike(kRegisters, "{kind: spike, value: b, amount: 40, probability: 0.1}");
  spike.until(seconds(40));
  int up = 0, down = 0;
  for (const double v : spike.values(1)) {
    EXPECT_TRUE(v == 100 || v == 140 || v == 60) << v;
    up += v == 140, down += v == 60;
  }
  EXPECT_NEAR(up + down, 400, 5 * 19);
  EXPECT_NEAR(up, down, 5 * 20);
  for (const auto* run : {&bias, &drift, &noise, &spike}) run->expect_accounted();
}

/// Every element of a picture as a number.
std::vector<int> pixels(const Seen& s) {
  const auto& info = std::get<ImageInfo>(s.info);
  std::vector<int> all;
  const auto byte = [&](std::size_t i) { return static_cast<int>(s.bytes[i]); };
  const std::size_t n = std::size_t{info.width_px} * info.height_px;
  for (std::size_t i = 0; i < n; ++i) {
    if (info.format == PixelFormat::mono12p)
      all.push_back(i % 2 == 0 ? byte(i / 2 * 3) | (byte(i / 2 * 3 + 1) & 0xf) << 8
                               : byte(i / 2 * 3 + 1) >> 4 | byte(i / 2 * 3 + 2) << 4);
    else if (info.format == PixelFormat::yuv422_8)
      all.push_back(byte(2 * i));
    else if (has_words(info.format))
      all.push_back(byte(2 * i) | byte(2 * i + 1) << 8);
    else
      all.push_back(byte(i));
  }
  return all;
}

TEST(Fault, PicturesChangeInDigitalNumbersWhateverTheirFormat) {
  for (const auto list :
       {std::span<const PixelFormat>(kPixelFormats), std::span<const PixelFormat>(kVideoFormats)})
    for (const PixelFormat format : list) {
      SCOPED_TRACE(pfnc_name(format));
      FaultRun bias(SampleKind::image, "{kind: bias, amount_dn: 20, from_s: 0.5}", nullptr,
                    std::make_unique<FormulaStream>(format));
      ASSERT_TRUE(bias.status) << bias.status.error().text();
      bias.until(seconds(1));
      EXPECT_THAT(pixels(bias.seen.front()), Each(100));
      EXPECT_THAT(pixels(bias.seen.back()), Each(120));
      // Clipped to what the format holds, not wrapped.
      FaultRun bright(SampleKind::image, "{kind: bias, amount_dn: 100000}", nullptr,
                      std::make_unique<FormulaStream>(format));
      bright.until(milliseconds(100));
      EXPECT_THAT(pixels(bright.seen.back()), Each((1 << significant_bits(format)) - 1));
      FaultRun dark(SampleKind::image, "{kind: drift, rate_dn_per_s: -1000}", nullptr,
                    std::make_unique<FormulaStream>(format));
      dark.until(seconds(1));
      EXPECT_THAT(pixels(dark.seen.back()), Each(0));
    }
}

TEST(Fault, NoiseOfPicturesHasItsSigmaAndDiffersFromPictureToPicture) {
  WorkerPool workers(2);
  const auto make = [] { return std::make_unique<FormulaStream>(PixelFormat::mono16, 200, 150); };
  FaultRun run(SampleKind::image, "{kind: noise, sigma_dn: 8}", &workers, make());
  ASSERT_TRUE(run.status) << run.status.error().text();
  run.until(milliseconds(200));
  ASSERT_GE(run.seen.size(), 10u);
  double sum = 0, squares = 0;
  for (const int v : pixels(run.seen[3])) sum += v - 100, squares += (v - 100.0) * (v - 100);
  const double n = 200 * 150;
  EXPECT_NEAR(sum / n, 0, 5 * 8 / std::sqrt(n));
  EXPECT_NEAR(squares / n, 64 + 1.0 / 12, 5 * 64 * std::sqrt(2 / n));
  EXPECT_NE(run.seen[3].bytes, run.seen[4].bytes);
  run.expect_accounted();
  // The same without workers: who computes it has no say.
  FaultRun alone(SampleKind::image, "{kind: noise, sigma_dn: 8}", nullptr, make());
  alone.until(milliseconds(200));
  ASSERT_EQ(alone.seen.size(), run.seen.size());
  for (std::size_t i = 0; i < run.seen.size(); ++i) EXPECT_EQ(alone.seen[i].bytes, run.seen[i].bytes) << i;
}

TEST(Fault, SpikesHitTheirShareOfPixels) {
  FaultRun run(SampleKind::image, "{kind: spike, amount_dn: 60, share: 0.05, probability: 1}");
  ASSERT_TRUE(run.status) << run.status.error().text();
  run.until(seconds(1));
  double hit = 0, n = 0;
  for (const Seen& s : run.seen)
    for (const int v : pixels(s)) {
      EXPECT_TRUE(v == 100 || v == 160 || v == 40);
      hit += v != 100, n += 1;
    }
  EXPECT_NEAR(hit / n, 0.05, 5 * std::sqrt(0.05 * 0.95 / n));
}

double range_of(const Seen& s, std::size_t i) {
  LidarPoint p;
  std::memcpy(&p, s.bytes.data() + i * sizeof p, sizeof p);
  return std::hypot(p.x_m, p.y_m, p.z_m);
}
float float_of(const Seen& s, std::size_t i) {
  float v = 0;
  std::memcpy(&v, s.bytes.data() + i * sizeof v, sizeof v);
  return v;
}

TEST(Fault, RangesChangeInMetresAlongTheRay) {
  FaultRun cloud(SampleKind::point_cloud,
                 "{kind: bias, amount_m: 0.25}, {kind: bias, value: remission, amount: 0.1}");
  ASSERT_TRUE(cloud.status) << cloud.status.error().text();
  cloud.until(milliseconds(100));
  EXPECT_NEAR(range_of(cloud.seen.back(), 7), 10.25, 1e-5);
  LidarPoint p;
  std::memcpy(&p, cloud.seen.back().bytes.data(), sizeof p);
  EXPECT_FLOAT_EQ(p.remission, 0.6F);
  FaultRun range(SampleKind::range_image,
                 "{kind: noise, sigma_m: 0.02}, {kind: bias, value: amplitude, amount: -400}");
  ASSERT_TRUE(range.status) << range.status.error().text();
  range.until(milliseconds(100));
  double squares = 0;
  for (std::size_t i = 0; i < 32 * 24; ++i) {
    const double d = float_of(range.seen.back(), i) - 5.0;
    squares += d * d;
    EXPECT_FLOAT_EQ(float_of(range.seen.back(), 32 * 24 + i), 600);
  }
  EXPECT_NEAR(squares / (32 * 24), 4e-4, 5 * 4e-4 * std::sqrt(2.0 / (32 * 24)));
}

TEST(Fault, FramesChangeByBytesOrBySignals) {
  FaultRun bytes(SampleKind::can_frame, "{kind: bias, value: byte_2, amount: 255}");
  ASSERT_TRUE(bytes.status) << bytes.status.error().text();
  bytes.until(milliseconds(100));
  for (const Seen& s : bytes.seen) {
    const auto& f = std::get<CanFrame>(s.info);
    EXPECT_EQ(f.data[2], static_cast<std::uint8_t>(s.stamp.sequence + 1));
    EXPECT_EQ(f.data[1], static_cast<std::uint8_t>(s.stamp.sequence + 1));
    EXPECT_EQ(f.data[3], static_cast<std::uint8_t>(s.stamp.sequence + 3));
  }
}

TEST(Fault, PosesUnitsFixesAndOdometryChangeByTheirNames) {
  FaultRun pose(SampleKind::pose,
                "{kind: bias, value: x, amount_m: 2}, {kind: drift, value: yaw, rate_rad_per_s: 0.5}");
  ASSERT_TRUE(pose.status) << pose.status.error().text();
  pose.until(seconds(1));
  const auto& T = std::get<Pose>(pose.seen.back().info);
  const double t = static_cast<double>(pose.seen.back().stamp.t_capture.ns()) * 1e-9;
  EXPECT_EQ(T.position_m[0], 2);
  EXPECT_NEAR(T.orientation_wxyz[0], std::cos(t / 4), 1e-12);
  EXPECT_NEAR(T.orientation_wxyz[3], std::sin(t / 4), 1e-12);

  FaultRun imu(
      SampleKind::imu,
      "{kind: bias, value: rate_z, amount_radps: 0.1}, {kind: bias, value: force_x, amount_mps2: 1}");
  ASSERT_TRUE(imu.status) << imu.status.error().text();
  imu.until(milliseconds(100));
  EXPECT_DOUBLE_EQ(std::get<ImuSample>(imu.seen.back().info).angular_rate_radps[2], 0.1);
  EXPECT_DOUBLE_EQ(std::get<ImuSample>(imu.seen.back().info).specific_force_mps2[0], 1);

  FaultRun fix(SampleKind::nav_fix,
               "{kind: bias, value: north, amount_m: 111}, {kind: bias, value: east, amount_m: 50}");
  ASSERT_TRUE(fix.status) << fix.status.error().text();
  fix.until(milliseconds(100));
  const auto& f = std::get<NavFix>(fix.seen.back().info);
  // A degree of latitude at 50° is 111 229 m, one of longitude 71 696 m (WGS 84).
  EXPECT_NEAR(f.latitude_deg - 50, 111.0 / 111229, 1e-7);
  EXPECT_NEAR(f.longitude_deg - 6, 50.0 / 71696, 1e-7);

  FaultRun slip(SampleKind::odometry, "{kind: drift, value: wheel_left, rate_rad_per_s: 2}");
  ASSERT_TRUE(slip.status) << slip.status.error().text();
  slip.until(milliseconds(500));
  EXPECT_NEAR(std::get<Odometry>(slip.seen.back().info).wheel_angle_rad[0],
              2e-9 * static_cast<double>(slip.seen.back().stamp.t_capture.ns()), 1e-12);
}

TEST(Fault, CorruptFlipsBitsAndCutsTheEndAndSaysSo) {
  FaultRun flips(SampleKind::image, "{kind: corrupt, flips: 5}");
  ASSERT_TRUE(flips.status) << flips.status.error().text();
  flips.until(milliseconds(100));
  int bits = 0;
  for (const std::byte b : flips.seen.back().bytes) bits += std::popcount(static_cast<unsigned>(b) ^ 100U);
  EXPECT_GT(bits, 0);
  EXPECT_LE(bits, 5);
  EXPECT_EQ(flips.seen.back().stamp.validity, kCorrupt);

  FaultRun cut(SampleKind::image, "{kind: corrupt, keep: 0.5}");
  cut.until(milliseconds(100));
  const auto& picture = cut.seen.back();
  ASSERT_EQ(picture.bytes.size(), 32u * 24);
  EXPECT_EQ(picture.bytes[32 * 12 - 1], std::byte{100});
  EXPECT_EQ(picture.bytes[32 * 12], std::byte{0});
  EXPECT_EQ(picture.stamp.validity, kIncomplete);
  EXPECT_EQ(cut.source.health().incomplete, cut.seen.size());

  FaultRun cloud(SampleKind::point_cloud, "{kind: corrupt, keep: 0.3, flagged: false}");
  cloud.until(milliseconds(100));
  EXPECT_EQ(std::get<PointCloudInfo>(cloud.seen.back().info).count, 15u);
  EXPECT_EQ(cloud.seen.back().bytes.size(), 15 * sizeof(LidarPoint));
  EXPECT_EQ(cloud.seen.back().stamp.validity, kValid);

  FaultRun range(SampleKind::range_image, "{kind: corrupt, keep: 0.25}");
  range.until(milliseconds(100));
  EXPECT_FLOAT_EQ(float_of(range.seen.back(), 0), 5);
  EXPECT_TRUE(std::isnan(float_of(range.seen.back(), 32 * 24 - 1)));

  FaultRun frame(SampleKind::can_frame, "{kind: corrupt, keep: 0.5}");
  frame.until(milliseconds(100));
  EXPECT_EQ(std::get<CanFrame>(frame.seen.back().info).length, 4);
}

TEST(Fault, TimestampsAndClocksMoveCaptureAndRelease) {
  FaultRun wrong(kRegisters, "{kind: timestamp, offset_ms: 50, probability: 0.1}");
  ASSERT_TRUE(wrong.status) << wrong.status.error().text();
  wrong.until(seconds(5));
  int moved = 0;
  for (const Seen& s : wrong.seen) {
    const Duration off =
        s.stamp.t_capture - (BenchTime(0) + milliseconds(10) * static_cast<std::int64_t>(s.stamp.sequence));
    EXPECT_TRUE(off == Duration(0) || off == milliseconds(50));
    EXPECT_EQ(s.stamp.t_release - s.stamp.t_capture, milliseconds(5));
    EXPECT_GE(s.at, s.stamp.t_release);
    moved += off != Duration(0);
  }
  EXPECT_NEAR(moved, 50, 5 * 7);
  EXPECT_GE(wrong.fault(0).count.changed, static_cast<std::uint64_t>(moved));
  EXPECT_LE(wrong.fault(0).count.changed,
            static_cast<std::uint64_t>(moved) + wrong.source.accounts().waiting);

  FaultRun skew(kRegisters, "{kind: clock_skew, ppm: 1000, from_s: 1}");
  skew.until(seconds(11));
  const Stamp& last = skew.seen.back().stamp;
  const BenchTime truth = BenchTime(0) + milliseconds(10) * static_cast<std::int64_t>(last.sequence);
  EXPECT_NEAR((last.t_capture - truth).seconds(), (truth - (BenchTime(0) + seconds(1))).seconds() * 1e-3,
              1e-8);

  FaultRun step(kRegisters, "{kind: clock_step, step_ms: -200, from_s: 1}");
  step.until(seconds(2));
  EXPECT_EQ(step.seen.size(), 200u);
  const Stamp& back = step.seen.back().stamp;
  EXPECT_EQ(back.t_capture,
            BenchTime(0) + milliseconds(10) * static_cast<std::int64_t>(back.sequence) - milliseconds(200));
  EXPECT_EQ(back.t_arrival - back.t_release, milliseconds(200)) << "it came when it came";
  for (const auto* run : {&wrong, &skew, &step}) run->expect_accounted();
}

TEST(Fault, DisconnectIsSeenAsLostAndCountedAndTheDeviceComesBack) {
  FaultRun run(kRegisters, "{kind: disconnect, from_s: 1, until_s: 1.5}");
  ASSERT_TRUE(run.status) << run.status.error().text();
  run.until(milliseconds(1200));
  EXPECT_FALSE(run.source.health().connected);
  EXPECT_EQ(run.port.status(), PortStatus::lost);
  EXPECT_EQ(run.source.health().reconnects, 0u);
  run.until(seconds(3));
  EXPECT_TRUE(run.source.health().connected);
  EXPECT_EQ(run.source.health().reconnects, 1u);
  EXPECT_FALSE(run.showed(PortStatus::lost, milliseconds(100), milliseconds(999)));
  EXPECT_FALSE(run.showed(PortStatus::lost, milliseconds(1600), seconds(3)));
  EXPECT_EQ(run.source.accounts().disconnected, 50u);
  EXPECT_EQ(run.source.health().lost, 50u);
  EXPECT_EQ(run.port.counters().lost_samples, 50u);
  run.expect_accounted();
  ASSERT_EQ(run.events.size(), 2u);
  EXPECT_THAT(run.events[0], HasSubstr("fault 0 of left begins in cycle 1000: {kind: disconnect"));
  EXPECT_THAT(run.events[1], AllOf(HasSubstr("fault 0 of left ends in cycle 1500"), HasSubstr("50 dropped")));
}

TEST(Fault, ASlowConsumerShowsInTheSourcesOwnCounters) {
  for (const char* mode : {"unread", "hold, leases: 16"}) {
    FaultRun run(kRegisters, std::string("{kind: slow_consumer, mode: ") + mode + ", from_s: 1, until_s: 2}");
    ASSERT_TRUE(run.status) << run.status.error().text();
    run.until(milliseconds(1900));
    const Health& inner = run.source.inner().health();
    const std::uint64_t backed_up = inner.no_slot + inner.ring_full;
    EXPECT_GT(backed_up, 50u) << mode;
    run.until(seconds(4));
    EXPECT_EQ(run.seen.back().stamp.sequence, 399u) << mode;
    EXPECT_EQ(inner.received, run.source.accounts().taken + inner.no_slot + inner.ring_full) << mode;
    EXPECT_EQ(run.port.counters().lost_samples, inner.no_slot + inner.ring_full) << mode;
    run.expect_accounted();
  }
}

TEST(Fault, IsOnBySchedulePeriodAndTrigger) {
  FaultRun run(kRegisters,
               "{kind: bias, value: b, amount: 1, every_s: 0.5, for_s: 0.1, from_s: 0.2, until_s: 2}");
  ASSERT_TRUE(run.status) << run.status.error().text();
  run.until(seconds(3));
  for (const Seen& s : run.seen) {
    const std::int64_t ms = s.at.ns() / 1'000'000;
    const bool on = ms >= 200 && ms < 2000 && (ms - 200) % 500 < 100;
    EXPECT_EQ(std::get<RegisterBlock>(s.info).value[1], on ? 101 : 100) << ms;
  }
  EXPECT_EQ(run.fault(0).count.begins, 4u);
  EXPECT_EQ(run.events.size(), 8u);
  EXPECT_EQ(run.fault(0).span_count, 4u);
}

/// A channel `left` with faults whose triggers look at `table`, whose register a counts its samples.
struct TwoChannels {
  explicit TwoChannels(const std::string& faults, const std::string& table_faults = "")
      : left(kRegisters, faults), table(kRegisters, table_faults) {
    if (!left.status) return;
    status = left.bench.bind(
        {{"left", &left.source.describe(), &left.port}, {"table", &table.source.describe(), &table.port}});
  }
  void until(Duration end) {
    for (; Duration(left.cycle * 1'000'000) < end;) {
      left.until(left.cycle * milliseconds(1) + milliseconds(1));
      table.until(table.cycle * milliseconds(1) + milliseconds(1));
    }
  }
  FaultRun left, table;
  Status status;
};

TEST(Fault, IsTriggeredByAnotherChannel) {
  TwoChannels above("{kind: bias, value: b, amount: 1, when: {channel: table, value: a, above: 30}}");
  ASSERT_TRUE(above.status) << above.status.error().text();
  above.until(milliseconds(600));
  for (const Seen& s : above.left.seen)
    EXPECT_EQ(std::get<RegisterBlock>(s.info).value[1], s.stamp.sequence > 31 ? 101 : 100)
        << s.stamp.sequence;

  TwoChannels gone("{kind: drop, when: {channel: table, is: lost}}",
                   "{kind: disconnect, from_s: 1, until_s: 2}");
  ASSERT_TRUE(gone.status) << gone.status.error().text();
  gone.until(seconds(3));
  // Lost until the sample after the return, which comes in the cycle of the 101st.
  EXPECT_EQ(gone.left.source.accounts().dropped, 101u);

  TwoChannels late("{kind: drop, for_s: 0.5, when: {channel: table, is: late}}",
                   "{kind: delay, delay_ms: 5, from_s: 1, until_s: 1.02}");
  ASSERT_TRUE(late.status) << late.status.error().text();
  late.until(seconds(3));
  EXPECT_NEAR(static_cast<double>(late.left.source.accounts().dropped), 50, 2);

  TwoChannels misspelt("{kind: drop, when: {channel: tabel, value: a, above: 30}}");
  ASSERT_FALSE(misspelt.status);
  EXPECT_THAT(misspelt.status.error().text(),
              AllOf(HasSubstr("rig.yaml:1:"), HasSubstr("did you mean 'table'?")));
  TwoChannels no_value("{kind: drop, when: {channel: table, value: aa, above: 30}}");
  ASSERT_FALSE(no_value.status);
  EXPECT_THAT(no_value.status.error().text(), HasSubstr("expected one of a, b"));
}

TEST(Fault, InjectedWhileTheRunGoesOnTakesEffectInTheNextCycleAndComesAgainFromTheRecord) {
  const auto node = [](const std::string& yaml) { return *ConfigDocument::parse(yaml, "fault"); };
  FaultRun run(kRegisters, "{kind: drop, probability: 0.01}");
  run.until(milliseconds(500));
  const auto index = run.bench.inject("left", node("{kind: noise, value: b, sigma: 3, for_s: 0.25}"));
  ASSERT_TRUE(index) << index.error().text();
  EXPECT_EQ(*index, 1u);
  run.until(seconds(1));
  ASSERT_TRUE(run.bench.inject("left", node("{kind: drop}")));
  run.until(milliseconds(1200));
  ASSERT_TRUE(run.bench.clear("left"));
  run.until(seconds(2));
  run.expect_accounted();
  EXPECT_THAT(run.events,
              ::testing::Contains(HasSubstr("live fault 1 of left begins in cycle 500: {kind: noise")));
  EXPECT_THAT(run.events, ::testing::Contains(HasSubstr("live fault 1 of left ends in cycle 750")));
  EXPECT_THAT(run.events, ::testing::Contains(HasSubstr("live fault 2 of left ends in cycle 1200")));
  EXPECT_NEAR(static_cast<double>(run.source.accounts().dropped), 20, 6);

  FaultRun again(kRegisters, "{kind: drop, probability: 0.01}");
  ASSERT_TRUE(again.source.stop());
  auto& faults = again.source.faults();
  ASSERT_TRUE(faults.schedule_live(node("{kind: noise, value: b, sigma: 3, for_s: 0.25}"), 1,
                                   milliseconds(500), milliseconds(750)));
  ASSERT_TRUE(faults.schedule_live(node("{kind: drop}"), 2, seconds(1), milliseconds(1200)));
  ArmContext context;
  context.virtual_time = true;
  ASSERT_TRUE(again.source.arm(context));
  ASSERT_TRUE(again.source.start(BenchTime(0)));
  again.until(seconds(2));
  EXPECT_EQ(again.sequences(), run.sequences());
  EXPECT_EQ(again.values(1), run.values(1));
  EXPECT_EQ(again.events, run.events);

  const auto refused = run.bench.inject("lef", node("{kind: drop}"));
  ASSERT_FALSE(refused);
  EXPECT_THAT(refused.error().text(), HasSubstr("did you mean 'left'?"));
  EXPECT_FALSE(run.bench.inject("left", node("{kind: drop, from_s: 3}"))) << "a live fault begins at once";
}

TEST(Fault, ThereIsALimitOfFaultsAndClearedOnesMakeRoom) {
  FaultRun run(kRegisters, "");
  const auto node = *ConfigDocument::parse("{kind: delay, delay_ms: 1}", "fault");
  for (int round = 0; round < 3; ++round) {
    for (std::size_t i = 0; i < FaultInjector::kMost; ++i) ASSERT_TRUE(run.bench.inject("left", node)) << i;
    const auto one_more = run.bench.inject("left", node);
    ASSERT_FALSE(one_more);
    EXPECT_EQ(one_more.error().code, ErrorCode::unavailable);
    run.until(run.cycle * milliseconds(1) + milliseconds(20));
    ASSERT_TRUE(run.bench.clear(""));
    run.until(run.cycle * milliseconds(1) + milliseconds(20));
  }
  run.expect_accounted();
}

TEST(Fault, DrawsDifferByFaultChannelAndSeedAndRepeat) {
  const auto dropped = [](const std::string& faults, std::uint64_t seed, const std::string& name) {
    FaultySource source(std::make_unique<FormulaStream>());
    auto config = fault_config(kRegisters, faults);
    config.seed = seed;
    config.name = name;
    EXPECT_TRUE(source.configure(config));
    ArmContext context;
    context.virtual_time = true;
    EXPECT_TRUE(source.arm(context));
    EXPECT_TRUE(source.start(BenchTime(0)));
    std::set<std::uint64_t> seen;
    for (int k = 0; k < 2000; ++k) {
      const BenchTime now = BenchTime(0) + milliseconds(k);
      source.complete_until(now);
      while (SampleLease s = source.poll(now)) seen.insert(s->stamp.sequence);
      source.begin_cycle(now);
    }
    return seen;
  };
  const std::string one = "{kind: drop, probability: 0.5}";
  const auto first = dropped(one, 7, "left");
  EXPECT_EQ(first, dropped(one, 7, "left"));
  EXPECT_NE(first, dropped(one, 8, "left"));
  EXPECT_NE(first, dropped(one, 7, "right"));
  // A second fault in front takes the index 0, and the draws of it.
  EXPECT_NE(first, dropped("{kind: delay, delay_ms: 1, from_s: 100}, " + one, 7, "left"));
}

TEST(Fault, WhatDoesNotFitIsRefusedWithItsPlace) {
  const auto refused = [](SampleKind kind, const std::string& faults) {
    FaultySource source(std::make_unique<FormulaStream>());
    const auto s = source.configure(fault_config(kind, faults));
    EXPECT_FALSE(s) << faults;
    return s ? std::string() : s.error().text();
  };
  EXPECT_THAT(refused(kRegisters, "{kind: dorp}"),
              AllOf(HasSubstr("rig.yaml:1:18: "), HasSubstr("kind"), HasSubstr("did you mean 'drop'?")));
  EXPECT_THAT(refused(kRegisters, "{kind: corrupt}"), HasSubstr("expected a fault that left can have"));
  EXPECT_THAT(refused(SampleKind::event, "{kind: bias, amount: 1}"), HasSubstr("can have"));
  EXPECT_THAT(refused(kRegisters, "{kind: bias, amount: 1}"), HasSubstr("value"));
  EXPECT_THAT(refused(kRegisters, "{kind: bias, value: c, amount: 1}"), HasSubstr("expected one of a, b"));
  EXPECT_THAT(refused(SampleKind::image, "{kind: bias, amount_m: 1}"), HasSubstr("amount_dn"));
  EXPECT_THAT(refused(kRegisters, "{kind: drop, probability: 1.5}"), HasSubstr("probability"));
  EXPECT_THAT(refused(kRegisters, "{kind: drop, from_s: 2, until_s: 1}"), HasSubstr("until_s"));
  EXPECT_THAT(refused(kRegisters, "{kind: drop, every_s: 2}"), HasSubstr("for_s"));
  EXPECT_THAT(refused(kRegisters, "{kind: disconnect, probability: 0.5}"), HasSubstr("unknown key"));
  EXPECT_THAT(refused(kRegisters, "{kind: burst_loss, share: 0.9, mean_burst: 2}"), HasSubstr("mean_burst"));
  EXPECT_THAT(refused(kRegisters, "{kind: drop, when: {channel: x}}"), HasSubstr("above"));
}

// ------------------------------------------------------------------ sinks

class NotedSink final : public Sink {
 public:
  bool command(const Command& c) noexcept override {
    given.push_back(c);
    counters_.accepted.fetch_add(1);
    return true;
  }
  void watch(const Heartbeat*, Duration) override {}
  std::vector<Command> given;

 protected:
  Status do_configure(const ChannelConfig&) override {
    description_.kind = kRegisters;
    description_.names = {"enable", "rate"};
    description_.units = {"", "deg/s"};
    return {};
  }
  Status do_arm(const ArmContext&) override { return {}; }
  Status do_start(BenchTime) override { return {}; }
  Status do_stop() override { return {}; }
};

/// 1000 commands, one each 10 ms, rate counting up.
std::vector<Command> commanded(const std::string& faults, Sink::Counters* counters = nullptr) {
  auto noted = std::make_unique<NotedSink>();
  NotedSink& inner = *noted;
  FaultySink sink(std::move(noted));
  const auto s = sink.configure(fault_config(kRegisters, faults));
  EXPECT_TRUE(s) << s.error().text();
  EXPECT_TRUE(sink.arm({}));
  EXPECT_TRUE(sink.start(BenchTime(0)));
  for (int k = 0; k < 1000; ++k) {
    Command c;
    c.sequence = static_cast<std::uint64_t>(k);
    c.t_issue = BenchTime(0) + milliseconds(10 * k);
    c.t_effect = c.t_issue + milliseconds(10);
    c.count = 2;
    c.value[0] = 1;
    c.value[1] = k;
    EXPECT_TRUE(sink.command(c));
  }
  if (counters) {
    counters->accepted = sink.counters().accepted.load();
    counters->dropped = sink.counters().dropped.load();
  }
  EXPECT_TRUE(sink.stop());
  return inner.given;
}

TEST(Fault, CommandsAreLostDelayedChangedAndStuck) {
  Sink::Counters n;
  EXPECT_NEAR(static_cast<double>(commanded("{kind: drop, probability: 0.2}", &n).size()), 800, 5 * 12.7);
  EXPECT_EQ(n.accepted, 1000u);
  EXPECT_NEAR(static_cast<double>(n.dropped), 200, 5 * 12.7);
  EXPECT_EQ(commanded("{kind: disconnect, from_s: 2, until_s: 3}").size(), 900u);
  EXPECT_NEAR(static_cast<double>(commanded("{kind: burst_loss, share: 0.3, mean_burst: 3}").size()), 700,
              130);

  const auto delayed = commanded("{kind: delay, delay_ms: 35, from_s: 1, until_s: 2}");
  ASSERT_EQ(delayed.size(), 1000u);
  EXPECT_EQ(delayed[150].t_effect - delayed[150].t_issue, milliseconds(45));
  EXPECT_EQ(delayed[150].value[1], 150);
  for (std::size_t i = 1; i < 1000; ++i) EXPECT_GE(delayed[i].t_effect, delayed[i - 1].t_effect);
  EXPECT_EQ(delayed[500].t_effect - delayed[500].t_issue, milliseconds(10));

  const auto stuck = commanded("{kind: stuck, from_s: 5, until_s: 6}");
  EXPECT_EQ(stuck[499].value[1], 499);
  EXPECT_EQ(stuck[599].value[1], 500);
  EXPECT_EQ(stuck[600].value[1], 600);
  EXPECT_EQ(commanded("{kind: bias, value: rate, amount: 0.5}")[10].value[1], 10.5);

  FaultySink sink(std::make_unique<NotedSink>());
  const auto refused = sink.configure(fault_config(kRegisters, "{kind: timestamp, offset_ms: 1}"));
  ASSERT_FALSE(refused);
  EXPECT_THAT(refused.error().text(), HasSubstr("takes commands"));
}

// ------------------------------------------------------------------ at random

std::string random_fault(std::mt19937& random, SampleKind kind) {
  const auto pick = [&](std::initializer_list<const char*> of) {
    return std::string(*(of.begin() + static_cast<std::ptrdiff_t>(random() % of.size())));
  };
  const bool elements = has_elements(kind);
  std::string value, unit;
  if (kind == kRegisters) value = ", value: " + pick({"a", "b"});
  if (kind == SampleKind::can_frame) value = ", value: " + pick({"byte_0", "byte_7", "byte_63"});
  if (kind == SampleKind::pose) value = ", value: " + pick({"x", "z"}), unit = "_m";
  if (kind == SampleKind::imu) value = ", value: " + pick({"rate_x", "rate_z"}), unit = "_radps";
  if (kind == SampleKind::nav_fix) value = ", value: " + pick({"east", "up"}), unit = "_m";
  if (kind == SampleKind::odometry) value = ", value: " + pick({"yaw", "wheel_right"}), unit = "_rad";
  if (kind == SampleKind::image) unit = "_dn";
  if (kind == SampleKind::range_image || kind == SampleKind::point_cloud) unit = "_m";
  while (true) switch (random() % kFaultKinds) {
      case 0:
        return "{kind: drop, probability: 0.5}";
      case 1:
        return "{kind: burst_loss, share: 0.6, mean_burst: 5}";
      case 2:
        return "{kind: delay, delay_ms: " + pick({"0.1", "30", "400"}) + "}";
      case 3:
        return "{kind: jitter, shape: exponential, mean_ms: 20}";
      case 4:
        return "{kind: stuck, freeze: " + pick({"true", "false"}) + "}";
      case 5:
        return "{kind: bias" + value + ", amount" + unit + ": " + pick({"1e9", "-3", "0.5"}) + "}";
      case 6:
        return "{kind: drift" + value + ", rate" + unit + "_per_s: 100}";
      case 7:
        return "{kind: noise" + value + ", sigma" + unit + ": 10}";
      case 8:
        return "{kind: spike" + value + ", amount" + unit + ": 50, probability: 0.5}";
      case 9:
        if (!elements && kind != SampleKind::can_frame) break;
        return "{kind: corrupt, flips: 40, keep: " + pick({"0", "0.33", "1"}) + "}";
      case 10:
        return "{kind: timestamp, offset_ms: " + pick({"-80", "70", "900"}) + ", probability: 0.5}";
      case 11:
        return "{kind: clock_skew, ppm: " + pick({"-100000", "100000"}) + "}";
      case 12:
        return "{kind: clock_step, step_ms: " + pick({"-500", "500"}) + "}";
      case 13:
        return "{kind: disconnect}";
      case 14:
        return "{kind: slow_consumer, mode: " + pick({"unread", "hold, leases: 12"}) + "}";
    }
}

TEST(Fault, AtRandomOnEveryKindOfSampleNothingHangsAndEveryLossIsAccountedFor) {
  WorkerPool workers(2);
  for (const SampleKind kind : {SampleKind::image, SampleKind::range_image, SampleKind::point_cloud,
                                SampleKind::can_frame, SampleKind::register_block, SampleKind::pose,
                                SampleKind::imu, SampleKind::nav_fix, SampleKind::odometry}) {
    SCOPED_TRACE(static_cast<int>(kind));
    std::mt19937 random(static_cast<unsigned>(kind));
    FaultRun run(kind, "", &workers, std::make_unique<FormulaStream>(PixelFormat::mono8, 160, 120));
    ASSERT_TRUE(run.status) << run.status.error().text();
    std::uint64_t handed = 0, overtaken = 0;
    for (int round = 0; round < 60; ++round) {  // of one second each
      for (std::uint32_t n = random() % 4; n > 0; --n) {
        const std::string yaml = random_fault(random, kind);
        const auto node = ConfigDocument::parse(yaml, "fault");
        ASSERT_TRUE(node);
        const auto injected = run.bench.inject("left", *node);
        ASSERT_TRUE(injected) << yaml << ": " << injected.error().text();
      }
      run.until(seconds(round) + milliseconds(700));
      ASSERT_TRUE(run.bench.clear(""));
      run.until(seconds(round + 1));
      for (std::size_t i = 1; i < run.seen.size(); ++i)
        overtaken += run.seen[i].stamp.sequence <= run.seen[i - 1].stamp.sequence;
      handed += run.seen.size();
      run.seen.clear();
      run.statuses.clear();
      run.statuses.resize(static_cast<std::size_t>(run.cycle));
    }
    run.until(seconds(62));
    handed += run.seen.size();
    EXPECT_EQ(overtaken, 0u);
    run.expect_accounted();
    const auto& a = run.source.accounts();
    const Health& inner = run.source.inner().health();
    EXPECT_EQ(a.handed_on, handed);
    EXPECT_EQ(a.waiting, 0u) << "all faults are over";
    EXPECT_EQ(inner.received, 6200u) << "none before the decorator vanishes";
    EXPECT_EQ(inner.received, a.taken + inner.no_slot + inner.ring_full);
    std::uint64_t dropped = 0;
    for (const auto& f : run.source.faults().live()) dropped += f->count.dropped;
    EXPECT_EQ(dropped, a.dropped + a.disconnected);
    // A port shows each, or counts it.
    const PortCounters& p = run.port.counters();
    EXPECT_EQ(handed, p.fresh + p.superseded + p.overflow);
    EXPECT_TRUE(run.source.health().connected);
    EXPECT_EQ(run.port.status() == PortStatus::lost, false);
  }
}

}  // namespace
}  // namespace rigor::test
