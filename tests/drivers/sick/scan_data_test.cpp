#include "drivers/sick/scan_data.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "drivers/sick/scan_geometry.h"
#include "tests/drivers/sick/recorded_dialogue.h"

namespace rigor::sick {
namespace {

ScanData full_scan() {
  ScanData s;
  s.serial_number = 0x01020304;
  s.device_status = {0, 2};
  s.telegram_counter = 65535;
  s.scan_counter = 7;
  s.time_since_startup_us = 0xFFFFFF00;
  s.time_of_transmission_us = 0x00000100;
  s.inputs = {0, 3}, s.outputs = {0, 7};
  s.layer_angle = -250;
  s.scan_frequency_hz_e2 = 2500;
  s.measurement_frequency_100hz = 540;
  s.encoders = {{0xDEADBEEF, 12}, {1, 2}};
  for (int e = 0; e < 5; ++e) {
    ScanChannel c;
    c.name = {'D', 'I', 'S', 'T', static_cast<char>('1' + e)};
    c.scale = 2, c.offset = 0.5F;
    c.start_deg_e4 = -50000, c.step_deg_e4 = 1667;
    for (int i = 0; i < 20; ++i) c.values.push_back(static_cast<std::uint16_t>(i * 3000 + e));
    s.channels16.push_back(c);
    c.name = {'R', 'S', 'S', 'I', static_cast<char>('1' + e)};
    c.scale = 1, c.offset = 0;
    for (auto& v : c.values) v &= 0xFF;
    s.channels8.push_back(c);
  }
  s.position.emplace().xyz_rotation = {1, 2, 3, -4, 5, 6.5F};
  s.position->rotation_type = 3;
  s.name = "front";
  s.comment = "left of the door";
  s.time = ScanTime{2026, 11, 21, 14, 59, 58, 999999};
  s.event.emplace().type = {'F', 'D', 'I', 'N'};
  s.event->angle = -5;
  return s;
}

TEST(Scan, EveryBlockSurvivesTheWire) {
  const ScanData sent = full_scan();
  Buffer wire, again;
  encode_scan(sent, wire);
  ScanData got;
  ASSERT_EQ(decode_scan(wire, got), ScanError::none);
  encode_scan(got, again);
  EXPECT_EQ(wire, again);
  EXPECT_EQ(got.encoders[0].position, 0xDEADBEEF);
  EXPECT_EQ(got.layer_angle, -250);
  ASSERT_EQ(got.channels16.size(), 5u);
  EXPECT_EQ(got.channels16[4].echo_of("DIST"), 4);
  EXPECT_EQ(got.channels16[4].echo_of("RSSI"), -1);
  EXPECT_EQ(got.channels16[4].values, sent.channels16[4].values);
  EXPECT_EQ(got.channels8[2].values, sent.channels8[2].values);
  EXPECT_EQ(got.position->xyz_rotation[5], 6.5F);
  EXPECT_EQ(got.name, "front");
  EXPECT_EQ(got.comment, "left of the door");
  EXPECT_EQ(got.time->microsecond, 999999u);
  EXPECT_EQ(got.event->angle, -5);
}

TEST(Scan, EndsWhereItsBytesEnd) {
  Buffer wire;
  encode_scan(full_scan(), wire);
  ScanData s;
  for (std::size_t n = 0; n < wire.size(); ++n)
    ASSERT_NE(decode_scan(Bytes(wire).first(n), s), ScanError::none) << "cut to " << n << " bytes";
  wire.push_back(0);
  EXPECT_EQ(decode_scan(wire, s), ScanError::too_long);
}

TEST(Scan, RefusesCountsThatNoDeviceHas) {
  ScanData empty;
  Buffer wire;
  encode_scan(empty, wire);
  const std::size_t encoders = 2 + 2 + 4 + 2 + 2 + 2 + 4 + 4 + 2 + 2 + 2 + 4 + 4;
  auto with = [&](std::size_t at, std::uint8_t high, std::uint8_t low) {
    Buffer b = wire;
    b[at] = high, b[at + 1] = low;
    ScanData s;
    return decode_scan(b, s);
  };
  ScanData s;
  ASSERT_EQ(decode_scan(wire, s), ScanError::none);
  EXPECT_EQ(with(encoders, 0xFF, 0xFF), ScanError::bad_count);
  EXPECT_EQ(with(encoders + 2, 0xFF, 0xFF), ScanError::bad_count);
  EXPECT_EQ(with(encoders + 2, 0, 1), ScanError::cut_short);
  EXPECT_EQ(with(encoders + 6, 0, 2), ScanError::bad_flag);
}

class Recorded : public testing::TestWithParam<test::Recording> {};

TEST_P(Recorded, EveryScanIsDecodedAndEncodedAgainByteForByte) {
  const auto& r = GetParam();
  RIGOR_SKIP_WITHOUT_RECORDING(r);
  const auto payloads = test::read_payloads(test::recording_path(r));
  FrameParser parser;
  CloudMaker clouds;
  MicrosecondClock clock;
  std::vector<std::byte> memory(2000 * sizeof(LidarPoint));
  std::size_t scans = 0, telegrams = 0;
  ScanData scan;
  std::uint16_t last_counter = 0;
  DeviceTime last_time;
  for (const auto& payload : payloads) {
    parser.add(payload);
    for (Bytes body = parser.next(); body.data(); body = parser.next()) {
      ++telegrams;
      const auto t = parse_telegram(body);
      ASSERT_TRUE(t) << telegrams;
      if (!t->is("sSN", "LMDscandata")) continue;
      ASSERT_EQ(decode_scan(t->values, scan), ScanError::none);
      Buffer again;
      const auto begin = begin_frame(again);
      for (const char c : std::string_view("sSN LMDscandata ")) again.push_back(static_cast<std::uint8_t>(c));
      encode_scan(scan, again);
      end_frame(again, begin);
      ASSERT_EQ(again, payload) << "scan " << scans;

      EXPECT_EQ(scan.serial_number, r.serial_number);
      EXPECT_EQ(scan.scan_frequency_hz_e2, static_cast<std::uint32_t>(r.frequency_hz * 100));
      ASSERT_GE(scan.channels16.size(), 1u);
      EXPECT_EQ(scan.channels16[0].values.size(), r.beams);
      EXPECT_EQ(scan.channels16.size(), r.wide_rssi ? 2u : 1u);
      EXPECT_EQ(scan.channels8.size(), r.wide_rssi ? 0u : 1u);
      const ScanInstants i = scan_instants(scan, clock);
      // No beam is fired after the scan was handed over, and none two revolutions before.
      const DeviceTime last_beam = i.first_beam + i.beam_step * static_cast<std::int64_t>(r.beams - 1);
      EXPECT_LE(last_beam, i.transmission);
      EXPECT_GT(last_beam, i.transmission - i.period * 2);
      if (scans > 0) {
        EXPECT_EQ(static_cast<std::uint16_t>(scan.scan_counter - last_counter), 1u) << "scan " << scans;
        EXPECT_NEAR((i.first_beam - last_time).seconds(), 1 / r.frequency_hz, 1e-3);
      }
      last_counter = scan.scan_counter, last_time = i.first_beam;

      std::uint32_t count = 0;
      ASSERT_TRUE(clouds.fill(scan, i.beam_step, memory, count));
      EXPECT_GT(count, r.beams * 3 / 4);
      const auto* points = reinterpret_cast<const LidarPoint*>(memory.data());
      std::size_t at = 0;
      for (std::size_t b = 0; b < r.beams; ++b) {
        const auto raw = scan.channels16[0].values[b];
        if (raw < kFirstRange) continue;
        const LidarPoint& p = points[at++];
        EXPECT_NEAR(std::hypot(p.x_m, p.y_m), raw * 1e-3, 1e-5);
        const double deg =
            std::remainder(std::atan2(p.y_m, p.x_m) / 0.017453292519943295 + 90 -
                               (r.start_deg + (r.stop_deg - r.start_deg) * static_cast<double>(b) /
                                                  (static_cast<double>(r.beams) - 1)),
                           360);
        EXPECT_NEAR(deg, 0, 1e-4) << "beam " << b;
        EXPECT_EQ(p.remission, (r.wide_rssi ? scan.channels16[1] : scan.channels8[0]).values[b]);
      }
      EXPECT_EQ(at, count);
      ++scans;
    }
  }
  EXPECT_EQ(scans, r.scans);
  EXPECT_EQ(telegrams, payloads.size());
  EXPECT_EQ(parser.skipped_bytes() + parser.bad_checksums() + parser.bad_lengths(), 0u);
}
INSTANTIATE_TEST_SUITE_P(Sick, Recorded, testing::Values(test::kLms511, test::kTim781),
                         [](const auto& i) { return std::string(i.index == 0 ? "LMS511" : "TiM781S"); });

TEST(Scan, StepsAreTwelfthsOfADegree) {
  EXPECT_DOUBLE_EQ(step_deg(1667), 1.0 / 6);
  EXPECT_DOUBLE_EQ(step_deg(3333), 1.0 / 3);
  EXPECT_DOUBLE_EQ(step_deg(833), 1.0 / 12);
  EXPECT_DOUBLE_EQ(step_deg(5000), 0.5);
  EXPECT_DOUBLE_EQ(step_deg(2500), 0.25);
  EXPECT_DOUBLE_EQ(step_deg(1000), 0.1);
  EXPECT_DOUBLE_EQ(step_deg(1300), 0.13);
}

TEST(Scan, MicrosecondsGoOnBeyond71Minutes) {
  MicrosecondClock clock;
  EXPECT_EQ(clock.at(0xFFFFFFF0).ns(), 0xFFFFFFF0LL * 1000);
  EXPECT_EQ(clock.at(0x10).ns(), (0x1'0000'0010LL) * 1000);
  EXPECT_EQ(clock.at(0xFFFFFFFF).ns(), 0xFFFFFFFFLL * 1000);  // a little earlier
}

// 270 degrees at 50 Hz: 1 degree takes 1/18000 s.
TEST(Scan, InstantsFollowTheMirror) {
  ScanData s;
  s.scan_frequency_hz_e2 = 5000;
  s.channels16.resize(1);
  s.channels16[0].start_deg_e4 = -450000, s.channels16[0].step_deg_e4 = 5000;
  s.channels16[0].values.resize(541);
  s.time_since_startup_us = 1'000'000;
  s.time_of_transmission_us = 1'020'000;
  MicrosecondClock clock;
  auto i = scan_instants(s, clock);
  EXPECT_EQ(i.period, milliseconds(20));
  EXPECT_EQ(i.first_beam.ns(), 1'000'000'000 + 2'500'000);  // 45 of 360 degrees behind the zero index
  EXPECT_NEAR(static_cast<double>(i.beam_step.ns()), 27777.8, 1);
  // Given away 3 ms after the stamp, when the last beam is 17.5 ms behind it: the stamp ends the scan.
  s.time_of_transmission_us = 1'003'000;
  i = scan_instants(s, clock);
  EXPECT_EQ(i.first_beam.ns(), 1'000'000'000 + 2'500'000 - 20'000'000);
}

LidarPoint at(double azimuth_deg, double range_m, float remission, std::uint8_t echo = 0) {
  const double a = azimuth_deg * 0.017453292519943295;
  return {static_cast<float>(range_m * std::cos(a)),
          static_cast<float>(range_m * std::sin(a)),
          0,
          remission,
          0,
          0,
          echo,
          0};
}

TEST(Scan, PointsGoToTheBeamsTheyCameFrom) {
  ChannelPlan plan;
  plan.pattern = {-45, 0.5, 541};
  plan.echoes = 2, plan.filter = EchoFilter::all;
  const std::vector<LidarPoint> points = {at(-135, 1, 10), at(0, 2.5, 20), at(0, 1.25, 30), at(135, 4, 300),
                                          at(0.25, 9, 1),  at(140, 9, 1),  at(90, 70, 5)};
  ScanData scan;
  ScanMaker maker;
  EXPECT_EQ(maker.fill(points, plan, scan), 1u + 0u + 1u)
      << "0.25 and 140 degrees are between and beyond the beams";
  ASSERT_EQ(scan.channels16.size(), 2u);
  ASSERT_EQ(scan.channels8.size(), 2u);
  const auto& d1 = scan.channels16[0].values;
  const auto& d2 = scan.channels16[1].values;
  EXPECT_EQ(d1[0], 1000);
  EXPECT_EQ(d1[270], 1250) << "the nearest echo is the first";
  EXPECT_EQ(d2[270], 2500);
  EXPECT_EQ(scan.channels8[0].values[270], 30);
  EXPECT_EQ(scan.channels8[1].values[270], 20);
  EXPECT_EQ(d1[540], 4000);
  EXPECT_EQ(scan.channels8[0].values[540], 255) << "RSSI ends at 255";
  EXPECT_EQ(d1[450], 0) << "70 m do not fit into 16 bits of mm";
  EXPECT_EQ(std::count(d1.begin(), d1.end(), 0), 541 - 3);

  plan.filter = EchoFilter::last, plan.echoes = 1, plan.distance_scale = 2;
  (void)maker.fill(points, plan, scan);
  EXPECT_EQ(scan.channels16[0].values[270], 1250) << "2.5 m in steps of 2 mm";
  EXPECT_EQ(scan.channels16[0].values[450], 35000);
  plan.filter = EchoFilter::first;
  (void)maker.fill(points, plan, scan);
  EXPECT_EQ(scan.channels16[0].values[270], 625);
}

TEST(Scan, PointsComeBackFromTheWire) {
  ChannelPlan plan;
  plan.pattern = {-45, 1.0 / 3, 811};
  plan.echoes = 5, plan.filter = EchoFilter::all, plan.rssi_16_bit = true;
  std::vector<LidarPoint> points;
  for (int i = 0; i < 811; i += 2)
    for (int e = 0; e < i % 5; ++e)
      points.push_back(at(-135 + i / 3.0, 1.0 + i * 0.01 + e, static_cast<float>(i * 50 + e),
                          static_cast<std::uint8_t>(e)));
  ScanData scan, back;
  ScanMaker maker;
  EXPECT_EQ(maker.fill(points, plan, scan), 0u);
  scan.scan_frequency_hz_e2 = 1500;
  Buffer wire;
  encode_scan(scan, wire);
  ASSERT_EQ(decode_scan(wire, back), ScanError::none);
  CloudMaker maker_back;
  std::vector<std::byte> memory(points.size() * sizeof(LidarPoint));
  std::uint32_t count = 0;
  ASSERT_TRUE(maker_back.fill(back, microseconds(61), memory, count));
  ASSERT_EQ(count, points.size());
  const auto* got = reinterpret_cast<const LidarPoint*>(memory.data());
  for (std::size_t i = 0; i < points.size(); ++i) {
    EXPECT_NEAR(got[i].x_m, points[i].x_m, 6e-4);
    EXPECT_NEAR(got[i].y_m, points[i].y_m, 6e-4);
    EXPECT_EQ(got[i].remission, points[i].remission);
    EXPECT_EQ(got[i].return_index, points[i].return_index);
  }
  // Scale and offset are the device's: what they make of the values need not be a number.
  auto hostile = back;
  hostile.channels16[0].offset = std::numeric_limits<float>::infinity();  // DIST1
  hostile.channels16[1].scale = std::numeric_limits<float>::max();        // DIST2
  hostile.channels16[7].scale = std::numeric_limits<float>::infinity();   // RSSI3
  ASSERT_TRUE(maker_back.fill(hostile, microseconds(61), memory, count));
  EXPECT_GT(count, 0u);
  for (std::size_t i = 0; i < count; ++i) {
    EXPECT_TRUE(std::isfinite(got[i].x_m) && std::isfinite(got[i].y_m));
    EXPECT_FALSE(std::isinf(got[i].remission));
    EXPECT_GE(got[i].return_index, 2);
  }
  // 811 beams of 2.7 ms begin 2.19 s after each other, which 2^31 ns are not.
  EXPECT_TRUE(maker_back.fill(back, microseconds(2651), memory, count));
  EXPECT_EQ(got[count - 1].t_offset_ns, 808 * 2'651'000);  // the last beam with an echo
  EXPECT_FALSE(maker_back.fill(back, microseconds(2700), memory, count));
  EXPECT_FALSE(
      maker_back.fill(back, microseconds(61), std::span(memory).first(100 * sizeof(LidarPoint)), count));
}

}  // namespace
}  // namespace rigor::sick
