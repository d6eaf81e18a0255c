// Channels of a receiver: in virtual time, over a pseudo-terminal and TCP from the emulated one, from
// recordings; receivers that go away, that another program has, that speak at another speed.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>

#include "drivers/gnss/gnss_source.h"
#include "drivers/gnss/gnss_virtual_source.h"
#include "drivers/serial/device_end.h"
#include "tests/drivers/gnss/formula_receiver.h"
#include "tests/drivers/gnss/gnss_test_tools.h"

namespace rigor::gnss {
namespace {

using test::config_of;
using test::eventually;
using test::FormulaReceiver;
using test::start_emulator;
using testing::HasSubstr;

struct Taken {
  Stamp stamp;
  NavFix fix;
  RegisterBlock registers;
  std::vector<LidarPoint> points;
};
void take(Source& source, BenchTime now, std::vector<Taken>& out) {
  while (auto lease = source.poll(now)) {
    Taken t{lease->stamp, {}, {}, {}};
    if (const auto* f = lease->as<NavFix>()) t.fix = *f;
    if (const auto* r = lease->as<RegisterBlock>()) t.registers = *r;
    if (const auto* c = lease->as<PointCloudInfo>()) {
      const auto* p = reinterpret_cast<const LidarPoint*>(lease->bytes().data());
      t.points.assign(p, p + c->count);
    }
    out.push_back(std::move(t));
  }
}
std::string error_of(const Status& s) { return s ? "no error" : s.error().text(); }

std::vector<Taken> run_virtual(
    const std::string& emulator, const ChannelConfig& config, int cycles,
    std::shared_ptr<FormulaReceiver> receiver = std::make_shared<FormulaReceiver>()) {
  GnssVirtualSource source(test::parts_of(std::move(receiver)), config_of(emulator).params);
  auto s = source.configure(config);
  if (s) s = source.arm({true, milliseconds(1)});
  if (s) s = source.start(BenchTime(0));
  EXPECT_EQ(error_of(s), "no error");
  std::vector<Taken> taken;
  for (std::int64_t k = 0; s && k < cycles; ++k) {
    source.complete_until(BenchTime(k * 1'000'000));
    take(source, BenchTime(k * 1'000'000), taken);
  }
  EXPECT_EQ(source.health().protocol_errors, 0U);
  return taken;
}

TEST(GnssVirtual, FixesAreThoseOfTheModelAtTheirInstants) {
  for (const char* speaks : {"ubx", "nmea", "both"}) {
    const auto got = run_virtual(std::string("{rate_hz: 10, speaks: ") + speaks + "}", config_of("{}"), 1000);
    ASSERT_EQ(got.size(), 10U) << speaks;
    for (std::size_t k = 0; k < got.size(); ++k) {
      EXPECT_EQ(got[k].stamp.t_capture, BenchTime(static_cast<std::int64_t>(k) * 100'000'000)) << speaks;
      EXPECT_EQ(got[k].stamp.t_release, got[k].stamp.t_capture + milliseconds(60));
      EXPECT_EQ(got[k].stamp.sequence, k);
      EXPECT_EQ(got[k].stamp.lost_before, 0U);
      EXPECT_EQ(got[k].fix.status, FixStatus::rtk_fixed);
      EXPECT_NEAR(got[k].fix.height_m, 100 + 1e-3 * static_cast<double>(k), *speaks == 'n' ? 0.11 : 1e-4)
          << speaks;
      EXPECT_EQ(got[k].fix.satellites, 14);
      EXPECT_NEAR(std::sqrt(got[k].fix.covariance_enu_m2[4]), 0.03, 6e-4);
    }
  }
}

TEST(GnssVirtual, RegistersHoldTheWholeSolutionAndPointsTheSatellites) {
  const auto values =
      run_virtual("{velocity_sigma_mps: 0}", config_of("{}", SampleKind::register_block), 500);
  ASSERT_EQ(values.size(), 5U);
  const auto value = [&](std::string_view name) {
    for (std::size_t i = 0; i < solution_values().size(); ++i)
      if (solution_values()[i].name == name) return values.back().registers.value[i];
    ADD_FAILURE() << name;
    return 0.0;
  };
  EXPECT_EQ(value("status"), 4);
  EXPECT_NEAR(value("velocity_east_mps"), 10, 0.05);
  EXPECT_NEAR(value("velocity_north_mps"), 0, 1e-3);
  EXPECT_NEAR(value("course_deg"), 90, 1e-3);
  EXPECT_EQ(value("satellites_in_view"), 17);
  EXPECT_NEAR(value("utc_s"), 1577836800.4, 1e-6);
  EXPECT_GT(value("hdop"), 0.3);

  const auto sky = run_virtual("{}", config_of("{}", SampleKind::point_cloud, milliseconds(100)), 300);
  ASSERT_EQ(sky.size(), 3U);
  ASSERT_EQ(sky[0].points.size(), 17U);
  int used = 0;
  for (const LidarPoint& p : sky[0].points) {
    EXPECT_NEAR(std::sqrt(p.x_m * p.x_m + p.y_m * p.y_m + p.z_m * p.z_m), 1, 1e-6);
    EXPECT_GT(p.ring, 0);
    used += p.flags & 1;
  }
  EXPECT_EQ(used, 14);
}

TEST(GnssVirtual, TheSameRunGivesTheSameSamples) {
  const auto a = run_virtual("{}", config_of("{}", SampleKind::register_block), 1500);
  const auto b = run_virtual("{}", config_of("{}", SampleKind::register_block), 1500);
  ASSERT_EQ(a.size(), b.size());
  for (std::size_t k = 0; k < a.size(); ++k)
    EXPECT_EQ(0, std::memcmp(a[k].registers.value.data(), b[k].registers.value.data(),
                             sizeof a[k].registers.value));
}

TEST(GnssVirtual, TheRigSetsTheReceiversRateAndMessages) {
  const auto got = run_virtual(
      "{rate_hz: 1, speaks: nmea}",
      config_of("{configure: {messages: [pvt, sat]}}", SampleKind::nav_fix, milliseconds(200)), 1000);
  ASSERT_EQ(got.size(), 5U);
  EXPECT_EQ(got[1].stamp.t_capture - got[0].stamp.t_capture, milliseconds(200));
}

/// A source at the emulated receiver.
class Line : public testing::Test {
 protected:
  void begin(const std::string& emulated, const std::string& keys, bool tcp = false) {
    emulator = start_emulator(emulated, receiver);
    at = emulator->where();
    start(keys, tcp);
  }
  std::string where(bool tcp) const {
    return tcp ? "address: 127.0.0.1, port: " + at.substr(at.find(':') + 1) : "device: " + at;
  }
  void start(const std::string& keys, bool tcp = false) {
    auto s = source.configure(config_of("{" + where(tcp) + keys + "}"));
    if (s) s = source.arm({});
    if (s) s = source.start(bench_now());
    ASSERT_EQ(error_of(s), "no error");
  }
  bool collect(std::size_t n) {
    const std::size_t until = taken.size() + n;
    return eventually([&] {
      take(source, bench_now() + seconds(1), taken);
      return taken.size() >= until;
    });
  }
  std::shared_ptr<FormulaReceiver> receiver = std::make_shared<FormulaReceiver>();
  std::unique_ptr<GnssEmulator> emulator;
  std::string at;
  GnssSource source;
  std::vector<Taken> taken;
};

TEST_F(Line, FixesComeThroughAPseudoTerminalAndTcpByEachProtocol) {
  for (const bool tcp : {false, true})
    for (const char* speaks : {"ubx", "nmea"}) {
      taken.clear();
      begin(std::string("{rate_hz: 10, speaks: ") + speaks + (tcp ? ", as: tcp, port: 0}" : "}"),
            ", ready_s: 20", tcp);
      ASSERT_TRUE(collect(8)) << speaks;
      for (std::size_t k = 1; k < taken.size(); ++k) {
        EXPECT_EQ(taken[k].stamp.sequence, taken[k - 1].stamp.sequence + 1 + taken[k].stamp.lost_before);
        EXPECT_EQ(taken[k].fix.status, FixStatus::rtk_fixed);
        EXPECT_EQ(taken[k].fix.satellites, 14);
        EXPECT_NEAR(taken[k].fix.latitude_deg, 48.5, 1e-7);
        EXPECT_GT(taken[k].stamp.sigma_capture.ns(), 0);
      }
      EXPECT_EQ(source.health().protocol_errors, 0U) << speaks;
      EXPECT_TRUE(emulator->health().connected);
      ASSERT_TRUE(source.stop());
      emulator.reset();
    }
}

TEST_F(Line, StampsAreThoseOfTheReceiversClock) {
  begin("{rate_hz: 10, processing_ms: 30}", ", ready_s: 20, output_delay_ms: 30");
  ASSERT_TRUE(collect(25));
  // Instants lie on tenths of UTC; the source knows that by arrivals alone, and arrivals are late, never
  // early.
  const EpochPair epoch = read_epoch();
  double worst_ms = 0;
  for (std::size_t k = 15; k < taken.size(); ++k) {
    const auto utc = epoch.to_utc(taken[k].stamp.t_capture).ns() % 100'000'000;
    worst_ms =
        std::max(worst_ms, std::abs(static_cast<double>(utc > 50'000'000 ? utc - 100'000'000 : utc)) * 1e-6);
    EXPECT_EQ(taken[k].stamp.validity, kValid);
  }
  EXPECT_LT(worst_ms, 30);  // a busy machine; 0.1 ms on a quiet one
  ASSERT_TRUE(source.stop());
}

TEST_F(Line, AReceiverThatIsUnpluggedComesBack) {
  const std::string link = testing::TempDir() + "rigor-gnss-replug";
  begin("{rate_hz: 10, link: " + link + "}", ", ready_s: 5");
  ASSERT_TRUE(collect(5));
  emulator.reset();  // the terminal is gone, and its name
  ASSERT_TRUE(eventually([&] { return !source.health().connected; }));
  take(source, bench_now() + seconds(1), taken);
  const std::size_t before = taken.size();
  emulator = start_emulator("{rate_hz: 10, link: " + link + "}", receiver);
  ASSERT_TRUE(collect(5));
  EXPECT_TRUE(source.health().connected);
  EXPECT_EQ(source.health().reconnects, 1U);
  EXPECT_GT(taken[before].stamp.sequence, taken[before - 1].stamp.sequence);
  ASSERT_TRUE(source.stop());
}

TEST_F(Line, ItsSpeedIsFoundAndAWrongOneIsSaid) {
  emulator = start_emulator("{rate_hz: 10, baud: 115200}", receiver);
  at = emulator->where();
  auto s = source.configure(config_of("{device: " + at + ", baud: 9600, ready_s: 1}"));
  if (s) s = source.arm({});
  EXPECT_THAT(error_of(s), HasSubstr("bytes that are none: check `baud`"));
  start(", baud: auto, ready_s: 20");
  EXPECT_TRUE(collect(3));
  EXPECT_EQ(source.health().protocol_errors, 0U);
  ASSERT_TRUE(source.stop());
}

TEST_F(Line, TheReceiverIsConfiguredAndItsSpeedChanged) {
  begin("{rate_hz: 1, speaks: nmea, baud: 9600}",
        ", baud: 9600, ready_s: 20, configure: {messages: [pvt, sat, tim_tp], baud: 230400}");
  ASSERT_TRUE(collect(5));
  EXPECT_GE(emulator->counters().requests, 3U);
  EXPECT_EQ(emulator->counters().refused, 0U);
  EXPECT_EQ(taken[4].stamp.sequence - taken[3].stamp.sequence, 1 + taken[4].stamp.lost_before);
  EXPECT_LT((taken[4].stamp.t_capture - taken[3].stamp.t_capture).seconds(), 0.9);
  ASSERT_TRUE(source.stop());
}

TEST_F(Line, CorrectionsReachTheReceiver) {
  auto base = serial::make_tcp_end("127.0.0.1", 0);
  ASSERT_TRUE(base->open());
  const std::string port = base->endpoint().substr(base->endpoint().find(':') + 1);
  begin("{rate_hz: 10, corrections_timeout_s: 1}",
        ", ready_s: 20, corrections: {address: 127.0.0.1, port: " + port + "}");
  ASSERT_TRUE(collect(2));
  EXPECT_EQ(taken.back().fix.status, FixStatus::fix);
  Buffer rtcm;
  for (const char c : std::string("ICY 200 OK\r\n"))
    rtcm.push_back(static_cast<std::uint8_t>(c));  // a caster's answer
  append_rtcm(rtcm, test::bytes_of("corrections"));
  MonotonicTime sent;
  ASSERT_TRUE(eventually([&] {
    if (base->fd() < 0) base->await(-1, milliseconds(10));
    if (base->fd() >= 0 && monotonic_now() - sent > milliseconds(200)) {
      EXPECT_EQ(serial::put_bytes(base->fd(), reinterpret_cast<const char*>(rtcm.data()), rtcm.size()),
                static_cast<ssize_t>(rtcm.size()));
      sent = monotonic_now();
    }
    take(source, bench_now() + seconds(1), taken);
    return taken.back().fix.status == FixStatus::rtk_fixed;
  }));
  EXPECT_GE(source.line_counters().rtcm_passed, 1U);
  EXPECT_EQ(emulator->counters().malformed, 0U);
  ASSERT_TRUE(source.stop());
}

TEST_F(Line, ChannelsOfOneReceiverShareItsLine) {
  begin("{rate_hz: 10}", ", ready_s: 20");
  GnssSource sky, other;
  ASSERT_TRUE(sky.configure(config_of("{" + where(false) + ", ready_s: 20}", SampleKind::point_cloud)));
  ASSERT_TRUE(sky.arm({}));
  ASSERT_TRUE(sky.start(bench_now()));
  std::vector<Taken> satellites;
  ASSERT_TRUE(collect(3));
  ASSERT_TRUE(
      eventually([&] { return take(sky, bench_now() + seconds(1), satellites), satellites.size() >= 3; }));
  EXPECT_EQ(satellites.back().points.size(), 17U);
  ASSERT_TRUE(other.configure(config_of("{" + where(false) + ", ready_s: 20, time: arrival}")));
  EXPECT_THAT(error_of(other.arm({})), HasSubstr("expected the same keys"));
  // The line stays open for the one that is left.
  ASSERT_TRUE(sky.stop());
  EXPECT_TRUE(collect(3));
  ASSERT_TRUE(source.stop());
}

TEST_F(Line, AnotherProgramsPortIsRefused) {
  begin("{rate_hz: 10}", ", ready_s: 20");
  serial::SerialSettings line;
  line.device = at;
  const auto second = serial::open_serial(line, serial::Sharing::exclusive);
  ASSERT_FALSE(second);
  EXPECT_THAT(second.error().text(), HasSubstr("another program has the port"));
  ASSERT_TRUE(source.stop());
  EXPECT_TRUE(serial::open_serial(line, serial::Sharing::exclusive));
}

TEST_F(Line, SilenceAndNonsenseAreALostReceiver) {
  auto mute = serial::make_pty_end("");
  ASSERT_TRUE(mute->open());
  auto s = source.configure(config_of("{device: " + mute->endpoint() + ", ready_s: 0.3}"));
  if (s) s = source.arm({});
  EXPECT_THAT(error_of(s), HasSubstr("got nothing: check that the receiver is on"));
  s = source.configure(config_of("{device: /dev/no-such-receiver}"));
  if (s) s = source.arm({});
  EXPECT_THAT(error_of(s), HasSubstr("check `device`"));
  s = source.configure(config_of("{device: /dev/null, address: 127.0.0.1}"));
  EXPECT_THAT(error_of(s), HasSubstr("expected either `device`"));
  EXPECT_THAT(error_of(source.configure(config_of("{device: /x, configure: {messages: [pvt, satt]}}"))),
              HasSubstr("got \"satt\""));
  EXPECT_THAT(error_of(source.configure(config_of("{device: /x, baud: 12345}"))),
              HasSubstr("expected one of 1200, "));
}

TEST_F(Line, WhatComesIsLoggedAsItCame) {
  const std::string log = testing::TempDir() + "rigor-gnss-log.ubx";
  begin("{rate_hz: 10, speaks: both}", ", ready_s: 20, log: " + log);
  ASSERT_TRUE(collect(8));
  ASSERT_TRUE(source.stop());
  const auto d = test::decode(test::read_file(log));
  EXPECT_GE(d.instants.size(), 8U);
  EXPECT_EQ(d.counters.bad_checksums + d.counters.garbage, 0U);
}

std::vector<Taken> run_recording(const std::string& file, SampleKind kind, Period period, int cycles) {
  GnssSource source;
  auto s = source.configure(config_of("{file: " + file + "}", kind, period));
  if (s) s = source.arm({true, milliseconds(1)});
  if (s) s = source.start(BenchTime(0));
  EXPECT_EQ(error_of(s), "no error");
  std::vector<Taken> taken;
  for (std::int64_t k = 0; s && k < cycles; ++k) {
    source.complete_until(BenchTime(k * 1'000'000));
    take(source, BenchTime(k * 1'000'000), taken);
  }
  return taken;
}

TEST(GnssRecording, ALogIsADeviceInVirtualTime) {
  RIGOR_NEEDS_GNSS_LOGS();
  const auto ubx = run_recording((test::logs() / "ublox-neo-m8n.log").string(), SampleKind::nav_fix,
                                 milliseconds(200), 5000);
  ASSERT_EQ(ubx.size(), 24U);
  EXPECT_EQ(ubx[0].stamp.t_capture, BenchTime(0));
  for (std::size_t k = 1; k < ubx.size(); ++k)
    EXPECT_EQ(ubx[k].stamp.t_capture - ubx[k - 1].stamp.t_capture, milliseconds(200)) << k;
  const auto nmea =
      run_recording((test::logs() / "ublox-8.log").string(), SampleKind::nav_fix, seconds(1), 72'100);
  ASSERT_EQ(nmea.size(), 72U);
  EXPECT_EQ(nmea[71].stamp.t_capture, BenchTime(71'000'000'000));
  EXPECT_NEAR(nmea[0].fix.height_m, 1123.4, 1e-9);
  const auto sky =
      run_recording((test::logs() / "ublox-8.log").string(), SampleKind::point_cloud, seconds(1), 5000);
  EXPECT_GE(sky.size(), 4U);
}

TEST(GnssRecording, AFileWithoutASolutionIsRefused) {
  const std::string file = testing::TempDir() + "rigor-gnss-nothing.nmea";
  std::ofstream(file) << "$GNTXT,01,01,02,nothing*4B\r\nand prose\n";
  GnssSource source;
  ASSERT_TRUE(source.configure(config_of("{file: " + file + "}")));
  EXPECT_THAT(error_of(source.arm({true, milliseconds(1)})), HasSubstr("found no solution in"));
  ASSERT_TRUE(source.configure(config_of("{file: /no/such/file.ubx}")));
  EXPECT_THAT(error_of(source.arm({true, milliseconds(1)})), HasSubstr("found no such file"));
}

}  // namespace
}  // namespace rigor::gnss
