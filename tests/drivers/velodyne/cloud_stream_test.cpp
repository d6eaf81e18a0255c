#include "drivers/velodyne/cloud_stream.h"

#include <gtest/gtest.h>

#include <functional>
#include <vector>

#include "tests/drivers/velodyne/made_packets.h"

namespace rigor::velodyne {
namespace {

struct Got {
  std::size_t points;
  BenchTime t;
  std::uint64_t sequence, lost_before;
  std::uint32_t packets_lost, validity;
  std::int32_t last_offset_ns;
};

/// Packets first … first + count − 1, without those that `lost` names; each arrives 1.4 ms after its first
/// firing.
std::vector<Got> run(CloudStream& stream, const test::Rotor& rotor, std::uint64_t count,
                     const std::function<bool(std::uint64_t)>& lost = {}) {
  std::vector<Got> got;
  const DeviceFacts& f = facts_of(rotor.model);
  for (std::uint64_t k = 0; k < count; ++k) {
    if (lost && lost(k)) continue;
    const auto w = rotor.packet(k, [](std::uint32_t) { return DataPacket::Return{1000, 1}; });
    const BenchTime arrival(1'000'000'000 + static_cast<std::int64_t>(k) * f.packet_ns(rotor.dual) +
                            f.packet_ns(rotor.dual) + 70'000);
    stream.take(w.bytes(), arrival, [&](const Cloud& c) {
      got.push_back({c.points.size(), c.t_capture, c.sequence, c.lost_before, c.packets_lost, c.validity,
                     c.points.empty() ? 0 : c.points.back().t_offset_ns});
    });
  }
  return got;
}

CloudStream make(CloudStreamOptions options = {}, Model model = Model::vlp16) {
  return CloudStream(PacketDecoder::create(model, factory_calibration(model)).value(), options);
}

TEST(CloudStream, CutsRevolutionsAndLosesNoReturn) {
  auto stream = make();
  const auto got = run(stream, {}, 754 * 2);
  // 2.0 s at 10 Hz, begun at the cut.
  ASSERT_EQ(got.size(), 20u);
  for (std::size_t i = 1; i < got.size(); ++i) {
    EXPECT_EQ(got[i].sequence, got[i - 1].sequence + 1);
    EXPECT_NEAR(static_cast<double>((got[i].t - got[i - 1].t).ns()), 1e8, 60'000)
        << "one sequence of 55.3 µs";
    EXPECT_TRUE(got[i].points == 1808 * 16 || got[i].points == 1809 * 16) << got[i].points;
    EXPECT_EQ(got[i].validity, 0u);
    EXPECT_EQ(got[i].lost_before, 0u);
  }
  EXPECT_NEAR(got[3].last_offset_ns, 99'960'000, 60'000);
}

TEST(CloudStream, APacketThatSays36000LosesNoReturnAndIsCounted) {
  auto stream = make();
  std::vector<Got> got;
  const test::Rotor rotor;
  for (std::uint64_t k = 0; k < 160; ++k) {
    const auto w = rotor.packet(k, [](std::uint32_t) { return DataPacket::Return{1000, 1}; });
    std::vector<std::uint8_t> bytes(w.bytes().begin(), w.bytes().end());
    // Azimuth 0 of the first block, as some devices write it.
    if (k == 0) bytes[2] = 36'000 & 0xFF, bytes[3] = 36'000 >> 8;
    stream.take(bytes, BenchTime(static_cast<std::int64_t>(k + 1) * 1'327'104), [&](const Cloud& c) {
      got.push_back({c.points.size(), c.t_capture, 0, 0, 0, c.validity, 0});
    });
  }
  ASSERT_EQ(got.size(), 2u);
  EXPECT_GE(got[0].points, 1808u * 16) << "the revolution that begins with that packet";
  EXPECT_EQ(got[0].validity, 0u);
  EXPECT_EQ(stream.counters().full_turns, 1u);
  EXPECT_EQ(stream.counters().malformed, 0u);
}

TEST(CloudStream, BeginsWithAWholeRevolution) {
  auto stream = make();
  const auto got = run(stream, {.azimuth_deg = 1}, 160);
  // Cuts at 99.7 and 199.7 ms: what came before the first is no revolution.
  ASSERT_EQ(got.size(), 1u);
  EXPECT_GT(got[0].points, 1800u * 16);
}

TEST(CloudStream, TheDevicesTimeIsTiedToTheBenchByArrivals) {
  auto stream = make();
  const auto got = run(stream, {}, 754 * 3);
  for (const Got& g : got) {
    // Every packet came 70 µs after its last firing. t is that of a firing near azimuth 0 on a grid of 100
    // ms.
    const double phase =
        std::fmod(static_cast<double>((g.t.ns() - 1'000'000'000 + 10'000'000) % 100'000'000), 1e8) - 1e7;
    EXPECT_NEAR(phase, 70'000, 60'000) << "the arrival's delay and at most one sequence";
  }
}

TEST(CloudStream, GoesOnOverTheHour) {
  auto stream = make();
  const auto got = run(stream, {.start_us = 3'599'500'000}, 754);
  ASSERT_EQ(got.size(), 10u);
  for (std::size_t i = 1; i < got.size(); ++i)
    EXPECT_NEAR(static_cast<double>((got[i].t - got[i - 1].t).ns()), 1e8, 60'000);
  EXPECT_EQ(stream.counters().clock_steps, 0u);
  EXPECT_EQ(stream.counters().packets_lost, 0u);
}

TEST(CloudStream, GpsTimeIsThatOfTheHour) {
  // UTC 500 s past some hour is bench time 1 s.
  const std::int64_t utc = 3'600'000'000'000LL * 480'000 + 500'000'000'000LL;
  auto stream = make({.time = TimeSource::utc});
  stream.clock().set_epoch({BenchTime(1'000'000'000), RealtimeTime(utc), Duration(100)});
  const auto got = run(stream, {.start_us = 500'000'000}, 754);
  ASSERT_FALSE(got.empty());
  for (const Got& g : got) {
    const double phase = static_cast<double>((g.t.ns() - 1'000'000'000 + 10'000'000) % 100'000'000) - 1e7;
    EXPECT_NEAR(phase, 0, 60'000);
  }
}

TEST(CloudStream, CountsLostPacketsAndMarksTheirRevolution) {
  auto stream = make();
  const auto got = run(stream, {}, 754, [](std::uint64_t k) { return k == 200 || k == 201 || k == 400; });
  EXPECT_EQ(stream.counters().packets_lost, 3u);
  ASSERT_EQ(got.size(), 10u);
  std::uint32_t lost = 0;
  for (const Got& g : got) {
    lost += g.packets_lost;
    EXPECT_EQ((g.validity & kIncomplete) != 0, g.packets_lost > 0);
    EXPECT_EQ(g.lost_before, 0u);
  }
  EXPECT_EQ(lost, 3u);
}

TEST(CloudStream, CountsRevolutionsThatNeverCame) {
  auto stream = make();
  // 0.35 s away in the middle of the third revolution.
  const auto got = run(stream, {}, 1508, [](std::uint64_t k) { return k >= 264 && k < 528; });
  EXPECT_EQ(stream.counters().packets_lost, 264u);
  std::uint64_t lost = 0;
  for (std::size_t i = 1; i < got.size(); ++i) {
    lost += got[i].lost_before;
    EXPECT_EQ(got[i].sequence, got[i - 1].sequence + 1 + got[i].lost_before);
  }
  EXPECT_EQ(lost, 5u) << "revolutions 3 to 7 had a part that never came";
  EXPECT_EQ(got.size() + lost, 20u);
}

TEST(CloudStream, GivesEachPacketWhereThatIsAskedFor) {
  auto stream = make({.unit = CloudUnit::packet});
  const auto got = run(stream, {}, 50, [](std::uint64_t k) { return k == 20; });
  ASSERT_EQ(got.size(), 49u);
  EXPECT_EQ(got[20].sequence, 21u);
  EXPECT_EQ(got[20].lost_before, 1u);
  EXPECT_EQ(got[5].points, 384u);
  EXPECT_NEAR(static_cast<double>((got[6].t - got[5].t).ns()), 1'327'104, 1100);
}

TEST(CloudStream, DropsWhatDoesNotFitAndSaysSo) {
  auto stream = make({.max_points = 20'000});
  const auto got = run(stream, {}, 300);
  ASSERT_FALSE(got.empty());
  EXPECT_EQ(got[0].points, 20'000u);
  EXPECT_TRUE(got[0].validity & kIncomplete);
  EXPECT_GT(stream.counters().points_dropped, 0u);
}

TEST(CloudStream, RefusesWhatIsNoPacket) {
  auto stream = make();
  std::vector<std::uint8_t> junk(1206, 0xAA);
  stream.take(junk, BenchTime(0), [](const Cloud&) { FAIL(); });
  stream.take(Bytes(junk).first(7), BenchTime(0), [](const Cloud&) { FAIL(); });
  EXPECT_EQ(stream.counters().malformed, 2u);
  EXPECT_EQ(stream.counters().packets, 0u);
}

}  // namespace
}  // namespace rigor::velodyne
