// Faults that change what a sample says: in its unit, by its name, in its format.
#include <cmath>

#include "tests/sensor-hal/channel/fault_fixture.h"

namespace rigor::test {
namespace {

using ::testing::Each;

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

}  // namespace
}  // namespace rigor::test
