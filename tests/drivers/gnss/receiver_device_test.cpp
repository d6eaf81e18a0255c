// The emulated receiver's model: what it says is what it measured, by each protocol; how it is configured;
// what corrections do to its fix.
#include "drivers/gnss/receiver_device.h"

#include <gtest/gtest.h>

#include <cmath>

#include "drivers/gnss/config_dialog.h"
#include "tests/drivers/gnss/formula_receiver.h"
#include "tests/drivers/gnss/gnss_test_tools.h"

namespace rigor::gnss {
namespace {

EmulatorSettings settings_of(const std::string& keys) {
  return read_emulator_settings(test::config_of(keys).params);
}

Measured measured_at(double latitude_deg, double longitude_deg, double height_m,
                     FixStatus status = FixStatus::rtk_fixed) {
  Measured m;
  m.fix.status = status;
  m.fix.satellites = 17;
  m.fix.latitude_deg = latitude_deg, m.fix.longitude_deg = longitude_deg, m.fix.height_m = height_m;
  m.fix.covariance_enu_m2 = {0.0004, 0.0001, 0, 0.0001, 0.0009, 0, 0, 0, 0.0025};
  m.velocity_enu_mps = {3, -4, 0.5};
  return m;
}

const RealtimeTime kUtc = realtime_of({2024, 2, 29, 23, 59, 59, 900'000'000});

struct Spoken {
  const char* keys;
  double place_deg, height_m, velocity_mps;  ///< half a unit of the last digit
  bool ubx;
};
class Protocols : public testing::TestWithParam<Spoken> {};

TEST_P(Protocols, SayWhatWasMeasuredUpToTheirLastDigit) {
  const Spoken& how = GetParam();
  struct Place {
    double lat, lon, h;
  };
  for (const Place& p : {Place{48.123456789, 9.25, 431.2345}, Place{-34.906226612, 138.608119912, -412.3},
                         Place{0.000000004, 179.999999996, 0}, Place{-0.5, -179.999999996, 8848.86},
                         Place{89.999999996, -90.1, 20}, Place{-90, 0, 2835}}) {
    ReceiverDevice device(settings_of(how.keys));
    Buffer all;
    for (std::uint64_t k = 0; k < 3; ++k) {
      device.speak(measured_at(p.lat, p.lon, p.h), kUtc + milliseconds(100) * static_cast<std::int64_t>(k), k,
                   BenchTime(0));
      all.insert(all.end(), device.output().begin(), device.output().end());
      device.output().clear();
    }
    const auto d = test::decode(all);
    ASSERT_EQ(d.instants.size(), 3U) << how.keys;
    EXPECT_EQ(d.counters.garbage + d.counters.bad_checksums + d.assembled.malformed, 0U);
    for (std::size_t k = 0; k < 3; ++k) {
      const Solution& s = d.instants[k].solution;
      EXPECT_EQ(*s.utc, kUtc + milliseconds(100) * static_cast<std::int64_t>(k));
      EXPECT_EQ(s.t_device - d.instants[0].solution.t_device,
                milliseconds(100) * static_cast<std::int64_t>(k));
      EXPECT_EQ(s.status, FixStatus::rtk_fixed);
      EXPECT_EQ(s.mode, Solution::Mode::fix_3d);
      EXPECT_EQ(s.satellites_used, 17);
      EXPECT_NEAR(s.latitude_deg, p.lat, how.place_deg);
      EXPECT_NEAR(std::remainder(s.longitude_deg - p.lon, 360), 0, how.place_deg);
      EXPECT_NEAR(s.height_m, p.h, how.height_m);
      EXPECT_NEAR(s.velocity_enu_mps[0], 3, how.velocity_mps);
      EXPECT_NEAR(s.velocity_enu_mps[1], -4, how.velocity_mps);
      EXPECT_NEAR(s.speed_mps, 5, how.velocity_mps);
      EXPECT_NEAR(s.covariance_enu_m2[0], 0.0004, how.ubx ? 1e-8 : 1e-4);
      EXPECT_NEAR(s.covariance_enu_m2[4], 0.0009, how.ubx ? 1e-8 : 1e-4);
      EXPECT_NEAR(s.covariance_enu_m2[8], 0.0025, how.ubx ? 1e-8 : 1e-4);
      EXPECT_NEAR(s.covariance_enu_m2[1], how.ubx ? 0.0001 : 0, 1e-9);
      const auto& sky = d.instants[k].sky;
      ASSERT_TRUE(sky);
      EXPECT_EQ(sky->satellites.size(), 20U);
      EXPECT_EQ(std::count_if(sky->satellites.begin(), sky->satellites.end(),
                              [](const Satellite& v) { return v.used; }),
                17);
      const Dilution dop = dilution_of(*sky);
      EXPECT_NEAR(s.hdop, dop.horizontal, 0.006);
      EXPECT_NEAR(s.vdop, dop.vertical, 0.006);
      EXPECT_NEAR(s.pdop, dop.position, 0.006);
    }
  }
}
INSTANTIATE_TEST_SUITE_P(Receiver, Protocols,
                         testing::Values(Spoken{"{speaks: ubx}", 0.51e-9, 0.51e-4, 0.51e-3, true},
                                         Spoken{"{speaks: nmea}", 0.51e-5 / 60, 0.11, 2e-3, false},
                                         Spoken{"{speaks: nmea, high_precision: true}", 0.51e-7 / 60, 1.1e-3,
                                                2e-3, false},
                                         Spoken{"{speaks: both}", 0.51e-9, 0.51e-4, 0.51e-3, true}));

TEST(Receiver, WithoutAFixItSaysSoAndGoesOn) {
  for (const char* keys : {"{speaks: ubx}", "{speaks: nmea}"}) {
    ReceiverDevice device(settings_of(keys));
    Measured none;
    device.speak(none, kUtc, 0, BenchTime(0));
    const auto d = test::decode(device.output());
    ASSERT_EQ(d.instants.size(), 1U) << keys;
    EXPECT_FALSE(d.instants[0].solution.has_fix());
    EXPECT_EQ(*d.instants[0].solution.utc, kUtc);
    EXPECT_EQ(nav_fix_of(d.instants[0].solution).status, FixStatus::none);
    EXPECT_EQ(d.assembled.malformed, 0U);
  }
}

TEST(Receiver, DilutionOfAKnownGeometry) {
  // Three at the horizon 120° apart, one overhead: GᵀG is diag(1.5, 1.5, …), by hand.
  Sky sky;
  for (const float az : {0.F, 120.F, 240.F}) sky.satellites.push_back({{Gnss::gps, 1}, 0, 0, az, 40, true});
  sky.satellites.push_back({{Gnss::gps, 4}, 0, 90, 0, 40, true});
  const Dilution d = dilution_of(sky);
  EXPECT_NEAR(d.horizontal, std::sqrt(4.0 / 3), 1e-6);
  EXPECT_NEAR(d.vertical, std::sqrt(4.0 / 3), 1e-6);
  EXPECT_NEAR(d.time, std::sqrt(1.0 / 3), 1e-6);
  sky.satellites.pop_back();
  EXPECT_TRUE(std::isnan(dilution_of(sky).horizontal));
}

/// A host and a receiver in one process.
Result<MonVer> configure(ReceiverDevice& device, const ConfigureSettings& wish, Duration period) {
  ConfigDialog dialog(wish, period, "rover");
  MessageStream answers;
  for (int i = 0; i < 100 && !dialog.done(); ++i) {
    device.receive(dialog.request(), BenchTime(0));
    answers.add(device.output());
    device.output().clear();
    while (const auto m = answers.next())
      if (auto taken = dialog.answer(*m); !taken) return tl::unexpected<Error>(taken.error());
  }
  EXPECT_TRUE(dialog.done());
  return dialog.version().value_or(MonVer{});
}

TEST(Receiver, BothGenerationsAreConfiguredByTheirOwnMessages) {
  for (const unsigned generation : {8U, 9U}) {
    ReceiverDevice device(settings_of("{speaks: nmea, generation: " + std::to_string(generation) + "}"));
    const auto version =
        configure(device, {0, Interface::uart1, {"pvt", "sat", "dop"}, 0}, milliseconds(200));
    ASSERT_TRUE(version) << version.error().text();
    EXPECT_EQ(version->generation(), generation);
    EXPECT_EQ(device.period(), milliseconds(200));
    Buffer all;
    for (std::uint64_t k = 0; k < 10; ++k) {
      device.speak(measured_at(48, 9, 100), kUtc + milliseconds(200) * static_cast<std::int64_t>(k), k,
                   BenchTime(0));
      all.insert(all.end(), device.output().begin(), device.output().end());
      device.output().clear();
    }
    const auto d = test::decode(all);
    EXPECT_EQ(d.counters.nmea, 0U) << generation;
    EXPECT_EQ(d.counters.ubx, 10U + 10 + 2) << generation;  // satellites once a second
    EXPECT_EQ(d.instants.size(), 10U);
  }
}

TEST(Receiver, WhatAGenerationDoesNotKnowIsRefused) {
  ReceiverDevice old(settings_of("{generation: 8}"));
  const auto refused = configure(old, {0, Interface::uart1, {"pvt", "cov"}, 0}, milliseconds(100));
  ASSERT_FALSE(refused);
  EXPECT_NE(refused.error().text().find("CFG-MSG for message 01-36"), std::string::npos)
      << refused.error().text();
  ReceiverDevice today(settings_of("{}"));
  EXPECT_FALSE(configure(today, {9, Interface::usb, {"rawx"}, 0}, milliseconds(100)));
  EXPECT_EQ(today.counters().refused, 1U);
  EXPECT_FALSE(configure(old, {9, Interface::uart1, {"pvt"}, 0}, milliseconds(100)));
  // Nothing of what was refused holds.
  today.speak(measured_at(48, 9, 100), kUtc, 0, BenchTime(0));
  EXPECT_EQ(test::decode(today.output()).instants.size(), 1U);
}

TEST(Receiver, ItsFixNeedsCorrectionsWhereTheRigSaysSo) {
  ReceiverDevice device(settings_of("{corrections_timeout_s: 5}"));
  const auto status = [&](std::int64_t at_s) {
    device.output().clear();
    device.speak(measured_at(48, 9, 100), kUtc, 0, BenchTime(at_s * 1'000'000'000));
    return test::decode(device.output()).instants.at(0).solution.status;
  };
  EXPECT_EQ(status(1), FixStatus::fix);
  Buffer rtcm;
  append_rtcm(rtcm, test::bytes_of("some corrections"));
  device.receive(Bytes(rtcm).first(7), BenchTime(2'000'000'000));
  device.receive(Bytes(rtcm).subspan(7), BenchTime(2'000'000'000));
  EXPECT_EQ(device.counters().rtcm, 1U);
  EXPECT_EQ(status(3), FixStatus::rtk_fixed);
  EXPECT_EQ(status(7), FixStatus::rtk_fixed);
  EXPECT_EQ(status(8), FixStatus::fix);
}

}  // namespace
}  // namespace rigor::gnss
