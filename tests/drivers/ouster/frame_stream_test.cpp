#include "drivers/ouster/frame_stream.h"

#include <gtest/gtest.h>

#include <functional>
#include <numbers>
#include <vector>

#include "drivers/ouster/imu_stream.h"
#include "tests/drivers/ouster/made_sensor.h"

namespace rigor::ouster {
namespace {

using test::made_metadata;

constexpr std::uint32_t kSlots = 32;  // of 512 columns
constexpr std::int64_t kFrame_ns = 100'000'000;

struct Got {
  std::size_t points;
  BenchTime t;
  std::uint64_t sequence, lost_before;
  std::uint32_t packets_lost, validity;
};

/// A stream in virtual time's clock, and packets that reach it.
struct Bench {
  explicit Bench(Metadata metadata, FrameStreamOptions options = {.time = packet_lidar::TimeSource::fixed})
      : m(std::move(metadata)), stream(m, options), writer(layout_of(m)) {}

  LidarPacketWriter& packet(std::uint64_t frame, std::uint32_t slot) {
    writer.set_header(static_cast<std::uint16_t>(frame), m.initialization_id, 1);
    for (std::uint32_t i = 0; i < 16; ++i) {
      const std::uint32_t id = slot * 16 + i;
      writer.set_column(
          i, static_cast<std::uint64_t>(static_cast<std::int64_t>(frame) * kFrame_ns + id * kFrame_ns / 512),
          static_cast<std::uint16_t>(id), m.window.has(id));
      for (std::uint32_t row = 0; row < test::kBeams; ++row) writer.set_pixel(i, row, {5000, 1, 2, 0});
    }
    return writer;
  }
  void take(Bytes bytes) {
    stream.take(bytes, BenchTime(0), [this](const packet_lidar::Cloud& c) {
      got.push_back({c.points.size(), c.t_capture, c.sequence, c.lost_before, c.packets_lost, c.validity});
    });
  }
  void send(std::uint64_t frame, std::uint32_t slot) { take(packet(frame, slot).bytes()); }
  void frame(std::uint64_t frame, const std::function<bool(std::uint32_t)>& lost = {}) {
    for (std::uint32_t slot = 0; slot < kSlots; ++slot)
      if (!lost || !lost(slot)) send(frame, slot);
  }

  Metadata m;
  FrameStream stream;
  LidarPacketWriter writer;
  std::vector<Got> got;
};

TEST(OusterFrames, AreHandedOnWithTheirLastPacket) {
  Bench b(made_metadata());
  for (std::uint64_t f = 65'534; f < 65'539; ++f) {  // frame ids start again at 0
    b.frame(f, [](std::uint32_t slot) { return slot == 31; });
    EXPECT_EQ(b.got.size(), f - 65'534);
    b.send(f, 31);
    EXPECT_EQ(b.got.size(), f - 65'533);
  }
  for (std::size_t i = 0; i < b.got.size(); ++i) {
    EXPECT_EQ(b.got[i].points, 512u * 32);
    EXPECT_EQ(b.got[i].sequence, i);
    EXPECT_EQ(b.got[i].validity, 0u);
    EXPECT_EQ(b.got[i].t.ns(), static_cast<std::int64_t>(65'534 + i) * kFrame_ns);
  }
  EXPECT_EQ(b.stream.counters().frames_lost, 0u);
}

TEST(OusterFrames, CountLostPacketsByFrameAndColumn) {
  Bench b(made_metadata());
  b.frame(1);
  b.frame(2, [](std::uint32_t slot) { return slot == 0 || slot == 7 || slot == 31; });
  b.frame(3);
  ASSERT_EQ(b.got.size(), 3u);
  EXPECT_EQ(b.got[1].packets_lost, 3u);
  EXPECT_EQ(b.got[1].validity, kIncomplete);
  EXPECT_EQ(b.got[1].points, 29u * 16 * 32);
  EXPECT_EQ(b.got[1].t.ns(), 2 * kFrame_ns) << "the first column's, although it is lost";
  EXPECT_EQ(b.got[2].validity, 0u);
  EXPECT_EQ(b.stream.counters().packets_lost, 3u);
  EXPECT_EQ(b.stream.counters().columns_lost, 48u);
  // Whole frames.
  b.frame(6);
  ASSERT_EQ(b.got.size(), 4u);
  EXPECT_EQ(b.got[3].sequence, 5u);
  EXPECT_EQ(b.got[3].lost_before, 2u);
  EXPECT_EQ(b.stream.counters().frames_lost, 2u);
}

TEST(OusterFrames, AColumnThatIsNotGoodIsMissing) {
  Bench b(made_metadata());
  for (std::uint32_t slot = 0; slot < kSlots; ++slot) {
    auto& w = b.packet(1, slot);
    if (slot == 4) w.set_column(2, 0, 0, false);
    b.take(w.bytes());
  }
  ASSERT_EQ(b.got.size(), 1u);
  EXPECT_EQ(b.got[0].points, 511u * 32);
  EXPECT_EQ(b.got[0].validity, kIncomplete);
  EXPECT_EQ(b.stream.counters().columns_lost, 1u);
  EXPECT_EQ(b.stream.counters().packets_lost, 0u);
}

TEST(OusterFrames, BeginWithAWholeOne) {
  Bench b(made_metadata());
  b.frame(1, [](std::uint32_t slot) { return slot < 10; });
  b.frame(2, [](std::uint32_t slot) { return slot < 2; });
  b.frame(3);
  ASSERT_EQ(b.got.size(), 2u) << "frame 1 was not seen from its beginning";
  EXPECT_EQ(b.got[0].sequence, 0u);
  EXPECT_EQ(b.got[0].packets_lost, 2u);
  EXPECT_EQ(b.got[1].sequence, 1u);
}

TEST(OusterFrames, LeaveAloneWhatComesLateOrTwice) {
  Bench b(made_metadata());
  b.frame(1, [](std::uint32_t slot) { return slot == 9; });
  b.send(2, 0);
  b.send(1, 9);  // overtaken
  b.send(2, 0);  // repeated
  b.frame(2, [](std::uint32_t slot) { return slot == 0 || slot == 31; });
  EXPECT_EQ(b.got.size(), 1u) << "a repeated packet stands for no other";
  b.send(2, 31);
  b.send(2, 5);  // after the frame was whole
  ASSERT_EQ(b.got.size(), 2u);
  EXPECT_EQ(b.got[0].packets_lost, 1u);
  EXPECT_EQ(b.got[1].points, 512u * 32);
  EXPECT_EQ(b.stream.counters().packets_late, 3u);
}

TEST(OusterFrames, HaveTheColumnsOfTheAzimuthWindow) {
  Metadata m = made_metadata();
  m.window = {500, 19};  // over the end of the turn: slots 31, 0 and 1, the first two of which in part
  Bench b(m);
  for (std::uint64_t f = 0; f < 3; ++f)
    for (const std::uint32_t slot : {0, 1, 31}) b.send(f, slot);
  ASSERT_EQ(b.got.size(), 3u);
  for (std::size_t f = 0; f < b.got.size(); ++f) {
    const Got& g = b.got[f];
    EXPECT_EQ(g.points, 32u * 32);
    EXPECT_EQ(g.validity, 0u);
    EXPECT_EQ(g.packets_lost, 0u);
    EXPECT_EQ(g.t.ns(), static_cast<std::int64_t>(f) * kFrame_ns) << "with column 0, which comes first";
  }
  EXPECT_EQ(FrameStream::max_points(m), 32u * 32);
}

TEST(OusterFrames, BeginInTimeWithTheFirstColumnOfTheWindow) {
  Metadata m = made_metadata();
  m.window = {128, 383};
  Bench b(m);
  for (std::uint32_t slot = 8; slot < 24; ++slot) b.send(1, slot);
  for (std::uint32_t slot = 10; slot < 24; ++slot) b.send(2, slot);  // the first two are lost
  b.send(3, 8);
  ASSERT_EQ(b.got.size(), 2u);
  EXPECT_EQ(b.got[0].t.ns(), kFrame_ns + kFrame_ns / 4);
  EXPECT_EQ(b.got[1].t.ns(), 2 * kFrame_ns + kFrame_ns / 4);
  EXPECT_EQ(b.got[1].packets_lost, 2u);
}

TEST(OusterFrames, ArePassedOnByTheirOwnColumnsAlone) {
  Metadata m = made_metadata();
  m.window = {0, 255};
  Bench b(m);
  for (std::uint32_t slot = 0; slot < 15; ++slot) b.send(1, slot);
  // A good column outside of the window, as of a sensor whose window has just been changed.
  auto& outside = b.packet(1, 20);
  outside.set_column(0, 1, 20 * 16, true);
  outside.set_pixel(0, 0, {5000, 1, 2, 0});
  b.take(outside.bytes());
  EXPECT_EQ(b.got.size(), 0u) << "a packet of the window is still to come";
  b.send(1, 15);
  ASSERT_EQ(b.got.size(), 1u);
  EXPECT_EQ(b.got[0].points, 256u * 32);
  EXPECT_EQ(b.got[0].validity, 0u);
}

TEST(OusterFrames, GoOnAfterTheSensorStartedAnew) {
  Bench b(made_metadata());
  b.frame(1000), b.frame(1001);
  b.frame(0), b.frame(1);
  ASSERT_EQ(b.got.size(), 4u);
  EXPECT_EQ(b.stream.counters().restarts, 1u);
  EXPECT_EQ(b.got[2].sequence, 3u);
  EXPECT_EQ(b.got[2].lost_before, 1u) << "what was not sent meanwhile is not known: at least one";
  EXPECT_EQ(b.got[3].sequence, 4u);
}

TEST(OusterFrames, TakeUpOtherMetadataWhereTheirFramesFit) {
  Metadata m = made_metadata();
  m.initialization_id = 5;
  Bench b(m, {.time = packet_lidar::TimeSource::fixed, .this_initialization_only = true});
  b.frame(7);
  b.m.initialization_id = 6;
  b.frame(0);
  EXPECT_EQ(b.got.size(), 1u) << "packets of a sensor that was configured anew";
  EXPECT_EQ(b.stream.counters().other_initialization, 32u);
  Metadata larger = made_metadata(Profile::single, {1024, 10});
  EXPECT_FALSE(b.stream.adopt(larger));
  m.initialization_id = 6;
  m.window = {0, 255};
  ASSERT_TRUE(b.stream.adopt(m));
  b.m.window = m.window;
  b.frame(1);
  ASSERT_EQ(b.got.size(), 2u);
  EXPECT_EQ(b.got[1].points, 256u * 32);
  EXPECT_GT(b.got[1].sequence, b.got[0].sequence + 1);
}

TEST(OusterFrames, HaveNoColumnBesideTheWindowEvenIfThePacketCallsItGood) {
  Metadata m = made_metadata();
  m.window = {8, 511};
  Bench b(m);
  for (std::uint32_t slot = 0; slot < kSlots - 1; ++slot) {  // the last one is lost: there is room for points
    auto& w = b.packet(1, slot);
    for (std::uint32_t i = 0; slot == 0 && i < 8; ++i) {
      w.set_column(i, static_cast<std::uint64_t>(kFrame_ns), static_cast<std::uint16_t>(i), true);
      for (std::uint32_t row = 0; row < test::kBeams; ++row) w.set_pixel(i, row, {5000, 1, 2, 0});
    }
    b.take(w.bytes());
  }
  b.send(2, 0);
  ASSERT_EQ(b.got.size(), 1u);
  EXPECT_EQ(b.got[0].points, 488u * 32);
  EXPECT_EQ(b.stream.counters().columns_lost, 16u);
}

TEST(OusterFrames, OfAnotherSensorHaveItsBeamsAndItsClock) {
  Metadata m = made_metadata();
  Bench b(m, {.time = packet_lidar::TimeSource::device});
  const auto height_of = [&](std::uint64_t frame, BenchTime at) {
    float z = 0;
    for (std::uint32_t slot = 0; slot < kSlots; ++slot)
      b.stream.take(b.packet(frame, slot).bytes(), at + microseconds(3125) * (slot + 1),
                    [&](const packet_lidar::Cloud& c) {
                      z = c.points[0].z_m;
                      b.got.push_back({c.points.size(), c.t_capture, c.sequence, c.lost_before,
                                       c.packets_lost, c.validity});
                    });
    return z;
  };
  const float before = height_of(50, BenchTime(5'000'000'000));
  m.T_sensor_lidar[11] += 1;
  ASSERT_TRUE(b.stream.adopt(m));
  // Its clock begins anew: frame 1 is at a tenth of a second.
  const float after = height_of(1, BenchTime(6'000'000'000));
  EXPECT_NEAR(after - before, 1, 1e-5);
  ASSERT_EQ(b.got.size(), 2u);
  EXPECT_NEAR(static_cast<double>((b.got[1].t - b.got[0].t).ns()), 1e9, 1e6);
}

TEST(OusterFrames, PointsHaveTheFieldThatWasAskedForAsRemission) {
  for (const auto& [field, expected] :
       {std::pair{Field::reflectivity, 3.0F}, {Field::signal, 2.0F}, {Field::near_infrared, 4.0F}}) {
    Bench b(made_metadata(), {.time = packet_lidar::TimeSource::fixed, .remission = field});
    float first = 0;
    for (std::uint32_t slot = 0; slot < kSlots; ++slot) {
      auto& w = b.packet(1, slot);
      w.set_pixel(0, 0, {5000, 2, 3, 0});
      w.set_near_infrared(0, 0, 4);
      b.stream.take(w.bytes(), BenchTime(0),
                    [&](const packet_lidar::Cloud& c) { first = c.points[0].remission; });
    }
    EXPECT_EQ(first, expected);
  }
}

TEST(OusterFrames, APacketThatBeginsLateWasFilledInLessTime) {
  Metadata m = made_metadata();
  m.window = {8, 15};  // half a packet of each turn: full 1.5625 ms after its first good column
  for (const auto source : {packet_lidar::TimeSource::arrival, packet_lidar::TimeSource::device}) {
    Bench b(m, {.time = source});
    for (std::int64_t f = 1; f < 20; ++f)
      b.stream.take(b.packet(static_cast<std::uint64_t>(f), 0).bytes(),
                    BenchTime(5'000'000'000 + f * kFrame_ns + 3'125'000), [&](const packet_lidar::Cloud& c) {
                      EXPECT_NEAR(static_cast<double>(c.t_capture.ns() - f * kFrame_ns),
                                  5'000'000'000.0 + 1'562'500, 200'000);
                      b.got.push_back({});
                    });
    EXPECT_EQ(b.got.size(), 19u);
  }
}

TEST(OusterFrames, DualReturnsAreTwoPoints) {
  Bench b(made_metadata(Profile::dual));
  std::vector<LidarPoint> points;
  for (std::uint32_t slot = 0; slot < kSlots; ++slot) {
    auto& w = b.packet(1, slot);
    for (std::uint32_t i = 0; i < 16; ++i) w.set_pixel(i, 3, {7000, 1, 9, 0}, 1);
    b.stream.take(w.bytes(), BenchTime(0),
                  [&](const packet_lidar::Cloud& c) { points.assign(c.points.begin(), c.points.end()); });
  }
  ASSERT_EQ(points.size(), 512u * 33);
  EXPECT_EQ(points[3].return_index, 0);
  EXPECT_EQ(points[4].return_index, 1);
  EXPECT_EQ(points[4].ring, 3);
  EXPECT_EQ(points[4].remission, 9);
}

TEST(OusterFrames, UtcOfTheSensorLeadsToBenchTime) {
  FrameStreamOptions o;
  o.time = packet_lidar::TimeSource::utc;
  o.utc_offset = seconds(-37);
  Bench b(made_metadata(), o);
  // The sensor counts TAI; bench time 5 s is UTC 100 s.
  b.stream.clock().set_epoch({BenchTime(5'000'000'000), RealtimeTime(100'000'000'000), Duration(0)});
  b.frame(1370);  // at TAI 137 s
  ASSERT_EQ(b.got.size(), 1u);
  EXPECT_EQ(b.got[0].t.ns(), 5'000'000'000);
}

TEST(OusterImu, IsInUnitsOfTheBenchAndCountsItsGaps) {
  ImuStream stream({packet_lidar::TimeSource::fixed, Duration(0), milliseconds(10)});
  const auto at = [&](std::uint64_t ms) {
    ImuPacket p;
    p.accelerometer_ns = ms * 1'000'000;
    p.acceleration_g = {0, 0, 1};
    p.turn_rate_dps = {180, 0, 0};
    return stream.take(compose_imu(p), BenchTime(0));
  };
  const auto first = at(1000);
  ASSERT_TRUE(first);
  EXPECT_EQ(first->t_capture.ns(), 1'000'000'000);
  EXPECT_DOUBLE_EQ(first->imu.specific_force_mps2[2], 9.80665);
  EXPECT_NEAR(first->imu.angular_rate_radps[0], std::numbers::pi, 1e-6);
  const auto second = at(1010), fifth = at(1040);
  ASSERT_TRUE(second && fifth);
  EXPECT_EQ(second->lost_before, 0u);
  EXPECT_EQ(fifth->lost_before, 2u);
  EXPECT_EQ(fifth->sequence, 4u);
  EXPECT_EQ(stream.counters().malformed, 0u);
  EXPECT_FALSE(at(1040)) << "repeated";
  EXPECT_EQ(stream.counters().malformed, 1u);
}

}  // namespace
}  // namespace rigor::ouster
