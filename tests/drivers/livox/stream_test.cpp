// From packets to clouds: frames of the device's time, losses by udp_cnt, clocks; and the device that makes
// them.
#include "drivers/livox/point_stream.h"

#include <gtest/gtest.h>

#include <optional>

#include "drivers/livox/imu_decoder.h"
#include "drivers/livox/mid360_device.h"
#include "tests/drivers/livox/made_livox.h"

namespace rigor::livox {
namespace {

using packet_lidar::Cloud;
using packet_lidar::TimeSource;
using test::FormulaMid360;
using test::plain_packet;

constexpr std::int64_t kPacketNs = kDots * kPoint_ns;

struct Got {
  std::vector<LidarPoint> points;
  BenchTime t;
  std::uint64_t sequence, lost_before;
  std::uint32_t packets_lost, validity;
};
struct Collector {
  std::vector<Got> clouds;
  packet_lidar::HandCloud hand = [this](const Cloud& c) {
    clouds.push_back({{c.points.begin(), c.points.end()},
                      c.t_capture,
                      c.sequence,
                      c.lost_before,
                      c.packets_lost,
                      c.validity});
  };
};
/// Frames of 4.8 ms: ten packets.
PointStreamOptions short_frames(TimeSource time = TimeSource::fixed) {
  PointStreamOptions o;
  o.time = time;
  o.frame = Duration(10 * kPacketNs);
  return o;
}

TEST(LivoxStream, MakesFramesOfTheDevicesTime) {
  PointStream stream(short_frames());
  Collector got;
  for (std::uint64_t j = 7; j < 30; ++j) {
    stream.take(plain_packet(j), BenchTime(0), got.hand);
    // With its last point a frame is handed on, not with the next packet.
    EXPECT_EQ(got.clouds.size(), j < 19 ? 0u : j < 29 ? 1u : 2u) << j;
  }
  ASSERT_EQ(got.clouds.size(), 2u) << "the first began before the packets did";
  for (std::size_t i = 0; i < 2; ++i) {
    const Got& c = got.clouds[i];
    EXPECT_EQ(c.t.ns(), static_cast<std::int64_t>(i + 1) * 10 * kPacketNs);
    EXPECT_EQ(c.sequence, i);
    EXPECT_EQ(c.validity, 0u);
    ASSERT_EQ(c.points.size(), 960u);
    for (std::size_t k = 0; k < 960; ++k) {
      ASSERT_EQ(c.points[k].t_offset_ns, static_cast<std::int32_t>(k * 5000));
      ASSERT_EQ(c.points[k].ring, k % 4);
      ASSERT_EQ(c.points[k].remission, 50);
    }
  }
}

TEST(LivoxStream, DividesAPacketBetweenFrames) {
  PointStreamOptions o;
  o.time = TimeSource::fixed;
  o.frame = milliseconds(1);  // 200 points: two packets and eight points
  PointStream stream(o);
  Collector got;
  for (std::uint64_t j = 0; j < 25; ++j) stream.take(plain_packet(j), BenchTime(0), got.hand);
  ASSERT_EQ(got.clouds.size(), 12u);
  for (std::size_t i = 0; i < 12; ++i) {
    EXPECT_EQ(got.clouds[i].points.size(), 200u) << i;
    EXPECT_EQ(got.clouds[i].t.ns(), static_cast<std::int64_t>(i) * 1'000'000);
    EXPECT_EQ(got.clouds[i].points[0].t_offset_ns, 0);
  }
}

TEST(LivoxStream, CountsWhatIsLostByTheCountOfPackets) {
  PointStream stream(short_frames());
  Collector got;
  for (std::uint64_t j = 0; j < 60; ++j) {
    if (j == 13 || j == 14 || (j >= 28 && j < 31)) continue;
    stream.take(plain_packet(j, 0, 65530), BenchTime(0), got.hand);  // the count passes 65535
  }
  ASSERT_EQ(got.clouds.size(), 6u);
  const std::uint32_t lost[] = {0, 2, 2, 1, 0, 0};
  for (std::size_t i = 0; i < 6; ++i) {
    EXPECT_EQ(got.clouds[i].packets_lost, lost[i]) << i;
    EXPECT_EQ(got.clouds[i].validity & kIncomplete, lost[i] > 0 ? kIncomplete : 0u) << i;
    EXPECT_EQ(got.clouds[i].points.size(), (10 - lost[i]) * 96) << i;
    EXPECT_EQ(got.clouds[i].t.ns(), static_cast<std::int64_t>(i) * 10 * kPacketNs);
  }
  EXPECT_EQ(stream.counters().packets_lost, 5u);
  EXPECT_EQ(stream.counters().frames_incomplete, 3u);
  EXPECT_EQ(stream.counters().clock_steps, 0u);
}

TEST(LivoxStream, BelievesTheTimesWhereTheCountBeginsAnew) {
  PointStream stream(short_frames());
  Collector got;
  // The count is 0 at the beginning of each frame, as the document has it, and three packets around it are
  // lost.
  for (std::uint64_t j = 0; j < 40; ++j) {
    if (j >= 19 && j < 22) continue;
    stream.take(plain_packet(j, 0, -static_cast<std::int64_t>(j / 10 * 10)), BenchTime(0), got.hand);
  }
  EXPECT_EQ(stream.counters().packets_lost, 3u);
  ASSERT_EQ(got.clouds.size(), 4u);
  EXPECT_EQ(got.clouds[0].validity, 0u);
  EXPECT_EQ(got.clouds[1].packets_lost, 1u);
  EXPECT_EQ(got.clouds[2].packets_lost, 2u);
  EXPECT_EQ(got.clouds[3].validity, 0u);
}

TEST(LivoxStream, FramesThatAreLostLeaveAGap) {
  PointStream stream(short_frames());
  Collector got;
  for (std::uint64_t j = 0; j < 60; ++j)
    if (j < 10 || j >= 40) stream.take(plain_packet(j), BenchTime(0), got.hand);
  ASSERT_EQ(got.clouds.size(), 3u);
  EXPECT_EQ(got.clouds[1].sequence, 4u);
  EXPECT_EQ(got.clouds[1].lost_before, 3u);
  EXPECT_EQ(got.clouds[1].validity, 0u) << "it lacks nothing itself";
  EXPECT_EQ(got.clouds[2].lost_before, 0u);
  EXPECT_EQ(stream.counters().packets_lost, 30u);
}

TEST(LivoxStream, PassesOverPacketsThatComeTwiceOrLate) {
  PointStream stream(short_frames());
  Collector got;
  for (std::uint64_t j : {0, 1, 2, 2, 4, 3, 5, 6, 7, 8, 9})
    stream.take(plain_packet(static_cast<std::uint64_t>(j)), BenchTime(0), got.hand);
  ASSERT_EQ(got.clouds.size(), 1u);
  EXPECT_EQ(got.clouds[0].points.size(), 9u * 96);
  EXPECT_EQ(stream.counters().packets_late, 2u);
  EXPECT_EQ(stream.counters().packets_lost, 1u);
}

TEST(LivoxStream, ADeviceThatIsSwitchedOnAnewBeginsAnew) {
  PointStream stream(short_frames());
  Collector got;
  for (std::uint64_t j = 1000; j < 1015; ++j) stream.take(plain_packet(j), BenchTime(0), got.hand);
  for (std::uint64_t j = 0; j < 20; ++j) stream.take(plain_packet(j), BenchTime(0), got.hand);
  ASSERT_EQ(got.clouds.size(), 3u);
  EXPECT_EQ(stream.counters().clock_steps, 1u);
  EXPECT_EQ(got.clouds[1].lost_before, 1u) << "what was begun is lost";
  EXPECT_EQ(got.clouds[1].sequence, got.clouds[0].sequence + 1 + got.clouds[1].lost_before);
  EXPECT_EQ(got.clouds[1].t.ns(), 0);
  EXPECT_EQ(got.clouds[2].sequence, got.clouds[1].sequence + 1);
}

TEST(LivoxStream, ADeviceThatBeginsAnewAfterAWholeFrameHasLostTheNext) {
  PointStream stream(short_frames());
  Collector got;
  for (std::uint64_t j = 1000; j < 1010; ++j) stream.take(plain_packet(j), BenchTime(0), got.hand);
  for (std::uint64_t j = 3; j < 30; ++j) stream.take(plain_packet(j), BenchTime(0), got.hand);
  ASSERT_EQ(got.clouds.size(), 3u);
  EXPECT_EQ(got.clouds[1].lost_before, 1u);
  EXPECT_EQ(got.clouds[1].sequence, got.clouds[0].sequence + 1 + got.clouds[1].lost_before);
  EXPECT_EQ(got.clouds[2].sequence, got.clouds[1].sequence + 1);
}

TEST(LivoxStream, ADeviceThatWasAwayForLongerThanItsClockSaysBeginsAnew) {
  // Switched off after 10 ms and on again; a second later it is where it was, and a little more.
  PointStream stream(short_frames(TimeSource::device));
  Collector got;
  for (std::uint64_t j = 0; j < 20; ++j)
    stream.take(plain_packet(j), BenchTime(static_cast<std::int64_t>(j + 1) * kPacketNs), got.hand);
  for (std::uint64_t j = 40; j < 60; ++j)
    stream.take(plain_packet(j), BenchTime(1'000'000'000 + static_cast<std::int64_t>(j + 1) * kPacketNs),
                got.hand);
  EXPECT_EQ(stream.counters().clock_steps, 1u);
  EXPECT_EQ(stream.counters().packets_lost, 0u) << "what it lost is not known";
  ASSERT_EQ(got.clouds.size(), 4u);
  EXPECT_GT(got.clouds[2].t.ns(), 1'000'000'000);
  EXPECT_EQ(got.clouds[2].lost_before, 1u);
}

TEST(LivoxStream, LeavesOutPointsOfLowConfidenceWhereAsked) {
  for (const bool drop : {false, true}) {
    PointStreamOptions o = short_frames();
    o.frame = Duration(kPacketNs);
    o.drop_noise = drop;
    PointStream stream(o);
    Collector got;
    std::vector<Point> points(kDots, Point{1, 0, 0, 1, 0});
    points[3].tag = 0x10;  // medium, other
    points[4].tag = 0x08;  // low, rain
    points[5].tag = 0xC0;  // reserved bits
    points[6] = {};
    std::vector<std::uint8_t> bytes;
    compose_points(DataType::cartesian_mm, {}, points, bytes);
    stream.take(bytes, BenchTime(0), got.hand);
    ASSERT_EQ(got.clouds.size(), 1u);
    EXPECT_EQ(got.clouds[0].points.size(), drop ? 93u : 95u);
    EXPECT_EQ(stream.counters().noise, drop ? 2u : 0u);
    EXPECT_EQ(stream.counters().points, 95u);
  }
}

TEST(LivoxStream, LeadsFromUtcToTheBench) {
  const EpochPair epoch{BenchTime(5'000'000'000), RealtimeTime(1'700'000'000'000'000'000), Duration(0)};
  const auto place = [&](TimeType type, std::optional<Duration> offset) {
    PointStreamOptions o = short_frames(TimeSource::utc);
    o.frame = Duration(kPacketNs);
    o.utc_offset = offset;
    PointStream stream(o);
    stream.clock().set_epoch(epoch);
    Collector got;
    PacketHead head;
    head.time_type = type;
    // A multiple of a frame, 480 µs.
    head.timestamp_ns = 1'700'000'037'000'000'000 / kPacketNs * kPacketNs;
    std::vector<std::uint8_t> bytes;
    compose_points(DataType::cartesian_mm, head, std::vector<Point>(kDots, Point{1, 0, 0, 1, 0}), bytes);
    stream.take(bytes, BenchTime(0), got.hand);
    EXPECT_EQ(got.clouds.size(), 1u);
    const std::int64_t past = 1'700'000'037'000'000'000 % kPacketNs;
    return std::pair(got.clouds[0].t.ns() + past, got.clouds[0].validity & kClockUnsure);
  };
  EXPECT_EQ(place(TimeType::ptp, {}), std::pair(std::int64_t{5'000'000'000}, 0u)) << "TAI is 37 s ahead";
  EXPECT_EQ(place(TimeType::gps, {}), std::pair(std::int64_t{42'000'000'000}, 0u));
  EXPECT_EQ(place(TimeType::ptp, Duration(0)).first, 42'000'000'000);
  EXPECT_EQ(place(TimeType::none, {}).second, kClockUnsure) << "a device that nobody has set";
}

TEST(LivoxStream, OfTheDeviceItselfHasWhatTheSimulatorMeasured) {
  auto device = Mid360Device::create(std::make_shared<FormulaMid360>(10'000'000));
  ASSERT_TRUE(device) << device.error().text();
  std::vector<packet_lidar::Scan> scans(30, device->make_scan());
  for (std::uint64_t k = 0; k < scans.size(); ++k)
    ASSERT_TRUE(device->measure(k, BenchTime(0) + device->begin(k), {}, scans[k]));
  for (const DataType type : {DataType::cartesian_mm, DataType::cartesian_cm, DataType::spherical}) {
    PointStreamOptions o;
    o.time = TimeSource::fixed;
    o.frame = milliseconds(10);
    PointStream stream(o);
    Collector got;
    std::vector<std::uint8_t> bytes;
    for (std::uint64_t j = 0; j < 600; ++j) {
      device->compose(
          j, type, {}, [&](std::uint64_t k) { return &scans.at(k); }, bytes);
      stream.take(bytes, BenchTime(0), got.hand);
    }
    EXPECT_EQ(stream.counters().packets_lost, 0u);
    EXPECT_EQ(stream.counters().packets_late, 0u);
    ASSERT_EQ(got.clouds.size(), 28u);
    // Half a unit each, and half a hundredth of a degree at 14 m.
    const double step_m = type == DataType::cartesian_mm   ? 5.1e-4
                          : type == DataType::cartesian_cm ? 5.1e-3
                                                           : 2.5e-3;
    for (std::size_t i = 0; i < got.clouds.size(); ++i) {
      EXPECT_EQ(got.clouds[i].t.ns(), static_cast<std::int64_t>(i) * 10'000'000);
      std::size_t expected = 0;
      for (std::uint64_t n = 0; n < 2000; ++n) expected += FormulaMid360::range_m(i * 2000 + n) > 0;
      ASSERT_EQ(got.clouds[i].points.size(), expected);
      for (const LidarPoint& p : got.clouds[i].points) {
        const std::uint64_t n = i * 2000 + static_cast<std::uint64_t>(p.t_offset_ns) / 5000;
        const auto at = FormulaMid360::place_m(n);
        ASSERT_EQ(p.ring, n % 4);
        ASSERT_EQ(p.remission, static_cast<float>(n % 200));
        ASSERT_NEAR(p.x_m, at[0], step_m);
        ASSERT_NEAR(p.y_m, at[1], step_m);
        ASSERT_NEAR(p.z_m, at[2], step_m);
      }
    }
  }
}

TEST(LivoxDevice, CountsItsPacketsFromTheBeginningOfEachFrame) {
  auto device = Mid360Device::create(std::make_shared<FormulaMid360>());
  ASSERT_TRUE(device);
  const auto count = [&](std::uint64_t j) {
    std::vector<std::uint8_t> bytes;
    device->compose(
        j, DataType::cartesian_mm, {TimeType::ptp, 7'000}, [](std::uint64_t) { return nullptr; }, bytes);
    PacketFault fault{};
    const auto p = Packet::parse(bytes, fault);
    EXPECT_TRUE(p);
    EXPECT_EQ(p->timestamp_ns(), 7'000 + j * 480'000);
    EXPECT_EQ(p->time_type(), TimeType::ptp);
    EXPECT_EQ(p->dots(), 96u);
    EXPECT_EQ(p->interval_ns(), 475'000);
    EXPECT_FALSE(p->point(0).is_return());
    return p->udp_count();
  };
  EXPECT_EQ(count(0), 0);
  EXPECT_EQ(count(208), 208);  // at 99.84 ms
  EXPECT_EQ(count(209), 0);    // at 100.32 ms
  EXPECT_EQ(count(416), 207);
  EXPECT_EQ(count(417), 0);  // at 200.16 ms
}

TEST(LivoxDevice, RefusesScansThatItDoesNotMake) {
  class Other final : public SampleProvider {
   public:
    models::LidarScan scan_;
    Geometry geometry() const override { return {SampleKind::point_cloud, 0, 0, 1024, "l"}; }
    const models::LidarScan* scan() const override { return &scan_; }
    Status capture(const Request&, Sample&) override { return {}; }
  };
  const auto other = std::make_shared<Other>();
  EXPECT_FALSE(Mid360Device::create(nullptr));
  EXPECT_NE(Mid360Device::create(other).error().text().find("no pattern"), std::string::npos);
  models::PatternTable table = models::parse_scan_pattern("0,1,1\n0.00001,2,2\n0.00002,3,3\n", "p").value();
  ASSERT_TRUE(models::set_period(table, 0));
  other->scan_ = models::table_scan(std::make_shared<models::PatternTable>(table), 30'000);
  EXPECT_NE(Mid360Device::create(other).error().text().find("10.000000 µs"), std::string::npos);
}

TEST(LivoxImu, GivesReadingsInSiUnits) {
  ImuDecoder imu({TimeSource::fixed, milliseconds(5)}, std::nullopt);
  imu.clock().set_fixed_offset(seconds(1));
  const auto packet = [](std::uint64_t i, float turn = 0.5F) {
    PacketHead head;
    head.timestamp_ns = i * 5'000'000;
    return compose_imu(head, {{turn, 0, 0}, {0, 0, 1}});
  };
  auto r = imu.take(packet(0), BenchTime(0));
  ASSERT_TRUE(r);
  EXPECT_NEAR(r->imu.specific_force_mps2[2], 9.80665, 1e-9);
  EXPECT_EQ(r->imu.angular_rate_radps[0], 0.5);
  EXPECT_EQ(r->t_capture.ns(), 1'000'000'000);
  r = imu.take(packet(4), BenchTime(0));
  ASSERT_TRUE(r);
  EXPECT_EQ(r->lost_before, 3u);
  EXPECT_EQ(r->sequence, 4u);
  EXPECT_FALSE(imu.take(packet(4), BenchTime(0))) << "again";
  EXPECT_FALSE(imu.take(packet(5, std::numeric_limits<float>::quiet_NaN()), BenchTime(0)));
  EXPECT_FALSE(imu.take(plain_packet(0), BenchTime(0)));
  EXPECT_EQ(imu.malformed(), 3u);
  r = imu.take(packet(5), BenchTime(0));
  ASSERT_TRUE(r);
  EXPECT_EQ(r->sequence, 5u);
}

}  // namespace
}  // namespace rigor::livox
