// Solutions from messages: instants, ends of weeks, leap seconds, dates that are missing or 1024 weeks old,
// places at the edges of the globe.
#include "drivers/gnss/epoch_assembler.h"

#include <gtest/gtest.h>

#include <cmath>

#include "drivers/gnss/nmea.h"
#include "drivers/gnss/receiver_stream.h"
#include "rt-core/byte_order.h"
#include "tests/drivers/gnss/gnss_test_tools.h"

namespace rigor::gnss {
namespace {

using test::decode;

Buffer sentences(std::initializer_list<const char*> texts) {
  Buffer b;
  for (const char* t : texts) append_sentence(b, t);
  return b;
}

TEST(GnssTime, DatesAndWeeksAreThoseOfTheCalendar) {
  // GPS week 2024-11-24 begins a Sunday; week 0 began 1980-01-06.
  EXPECT_EQ(days_from_date(1970, 1, 1), 0);
  EXPECT_EQ(days_from_date(1980, 1, 6), 3657);
  EXPECT_EQ(days_from_date(2000, 3, 1), 11017);
  const GpsTime t = gps_time(realtime_of({2017, 7, 19, 8, 50, 1, 0}), 18);
  EXPECT_EQ(t.week, 1958);
  EXPECT_EQ(t.tow_ns, 291'019'000'000'000);
  EXPECT_EQ(utc_of_gps(t, 18), realtime_of({2017, 7, 19, 8, 50, 1, 0}));
  for (const int year : {1980, 1999, 2000, 2024, 2100, 2199})
    for (int month = 1; month <= 12; ++month)
      for (const int day : {1, 28, 29, 30, 31}) {
        if (!is_date(year, month, day)) continue;
        const UtcTime u = utc_time(realtime_of({year, month, day, 23, 59, 58, 7}));
        EXPECT_EQ(std::tie(u.year, u.month, u.day, u.hour, u.minute, u.second),
                  std::make_tuple(year, month, day, 23, 59, 58));
        EXPECT_EQ(u.nanosecond, 7);
      }
  EXPECT_FALSE(is_date(2023, 2, 29));
  EXPECT_TRUE(is_date(2024, 2, 29));
  EXPECT_FALSE(is_date(2100, 2, 29));
  EXPECT_FALSE(is_date(2024, 13, 1));
}

TEST(GnssTime, DatesOfOldFirmwareAreRepairedAndOthersAreNot) {
  const RealtimeTime now = realtime_of({2026, 11, 26, 12, 0, 0, 0});
  const RealtimeTime behind(now.ns() - 1024 * kWeek_ns + 1'000'000'000);
  ASSERT_TRUE(repaired_rollover(behind, now));
  EXPECT_EQ(repaired_rollover(behind, now)->ns(), now.ns() + 1'000'000'000);
  EXPECT_EQ(repaired_rollover(RealtimeTime(behind.ns() - 1024 * kWeek_ns), now)->ns(),
            now.ns() + 1'000'000'000);
  EXPECT_FALSE(repaired_rollover(now, now));
  // A recording of some year is one.
  EXPECT_FALSE(repaired_rollover(realtime_of({2017, 1, 10, 0, 9, 41, 0}), now));
  EXPECT_FALSE(repaired_rollover(RealtimeTime(behind.ns() - 3 * kDay_ns), now));
}

NavPvt pvt_at(std::uint32_t itow_ms) {
  NavPvt v;
  v.itow_ms = itow_ms;
  v.year = 2024, v.month = 3, v.day = 2, v.hour = 23, v.minute = 59, v.second = 42;
  v.valid = 7, v.fix_type = 3, v.flags = 1, v.satellites = 9;
  return v;
}

TEST(Epochs, TheEndOfTheWeekIsNoStep) {
  Buffer b;
  for (const std::uint32_t itow : {604'799'800U, 604'799'900U, 0U, 100U}) append_nav_pvt(b, pvt_at(itow));
  const auto d = decode(b);
  ASSERT_EQ(d.instants.size(), 4U);
  for (std::size_t i = 1; i < 4; ++i)
    EXPECT_EQ(d.instants[i].solution.t_device - d.instants[i - 1].solution.t_device, milliseconds(100)) << i;
}

TEST(Epochs, ALeapSecondIsNoStepOfTheReceiversClock) {
  Buffer b;
  for (const char* time : {"235958.00", "235959.00", "235960.00", "000000.00", "000001.00"}) {
    const std::string date = time[0] == '2' ? "311216" : "010117";
    append_sentence(b,
                    "GNRMC," + std::string(time) + ",A,4800.00000,N,01100.00000,E,0.000,," + date + ",,,A,V");
  }
  const auto d = decode(b);
  ASSERT_EQ(d.instants.size(), 5U);
  for (std::size_t i = 1; i < 5; ++i)
    EXPECT_EQ(d.instants[i].solution.t_device - d.instants[i - 1].solution.t_device, seconds(1)) << i;
  // POSIX time counts no leap second: the one and the first of the next day are the same.
  EXPECT_EQ(*d.instants[2].solution.utc, realtime_of({2017, 1, 1, 0, 0, 0, 0}));
  EXPECT_EQ(*d.instants[3].solution.utc, realtime_of({2017, 1, 1, 0, 0, 0, 0}));
  EXPECT_EQ(*d.instants[1].solution.utc, realtime_of({2016, 12, 31, 23, 59, 59, 0}));
}

TEST(Epochs, MidnightIsNoStepAndTheDateGoesOn) {
  const auto d = decode(sentences({"GNRMC,235959.50,A,4800.00000,N,01100.00000,E,0.000,,280224,,,A,V",
                                   "GNGGA,000000.00,4800.00000,N,01100.00000,E,1,09,0.9,500.0,M,47.0,M,,",
                                   "GNGGA,000000.50,4800.00000,N,01100.00000,E,1,09,0.9,500.0,M,47.0,M,,"}));
  ASSERT_EQ(d.instants.size(), 3U);
  EXPECT_EQ(d.instants[2].solution.t_device - d.instants[0].solution.t_device, seconds(1));
  EXPECT_EQ(*d.instants[1].solution.utc, realtime_of({2024, 2, 29, 0, 0, 0, 0}));
}

TEST(Epochs, BeforeTheDateIsKnownASolutionHasNone) {
  const auto d = decode(sentences({"GNGGA,120000.00,4800.00000,N,01100.00000,E,1,05,2.0,500.0,M,47.0,M,,",
                                   "GNRMC,120000.00,A,4800.00000,N,01100.00000,E,0.000,,,,,A,V",
                                   "GNGGA,120001.00,4800.00000,N,01100.00000,E,1,05,2.0,500.0,M,47.0,M,,",
                                   "GNRMC,120001.00,A,4800.00000,N,01100.00000,E,0.000,,020324,,,A,V"}));
  ASSERT_EQ(d.instants.size(), 2U);
  EXPECT_FALSE(d.instants[0].solution.utc);
  EXPECT_TRUE(d.instants[0].solution.has_fix());
  EXPECT_EQ(*d.instants[1].solution.utc, realtime_of({2024, 3, 2, 12, 0, 1, 0}));
  // NAV-PVT says by `valid` whether it knows.
  Buffer b;
  NavPvt v = pvt_at(1000);
  v.valid = 2;
  append_nav_pvt(b, v);
  EXPECT_FALSE(decode(b).instants.at(0).solution.utc);
}

TEST(Epochs, SentencesWithoutTimeOrPlaceAreNoFix) {
  const auto d = decode(sentences(
      {"GNRMC,,V,,,,,,,,,,N,V", "GNGGA,,,,,,0,00,99.99,,,,,,", "GNGSA,A,1,,,,,,,,,,,,,99.99,99.99,99.99,1",
       "GNRMC,120000.00,V,,,,,,,020324,,,N,V", "GNGGA,120000.00,,,,,0,00,99.99,,,,,,"}));
  ASSERT_EQ(d.instants.size(), 1U);
  const Solution& s = d.instants[0].solution;
  EXPECT_FALSE(s.has_fix());
  EXPECT_EQ(s.mode, Solution::Mode::none);
  const NavFix f = nav_fix_of(s);
  EXPECT_EQ(f.status, FixStatus::none);
  EXPECT_TRUE(std::isnan(f.latitude_deg));
  EXPECT_EQ(d.assembled.malformed, 0U);
}

TEST(Epochs, PlacesAtTheEdgesOfTheGlobe) {
  struct Case {
    const char *latitude, *longitude;
    double lat, lon;
  };
  for (const Case& c :
       {Case{"9000.00000,N", "00000.00000,E", 90, 0}, Case{"9000.00000,S", "18000.00000,W", -90, -180},
        Case{"0000.00000,N", "17959.99999,E", 0, 180 - 0.00001 / 60},
        Case{"0000.00001,S", "17959.9999999,W", -0.00001 / 60, -180 + 0.0000001 / 60}}) {
    Buffer b;
    append_sentence(
        b, std::string("GNGGA,120000.00,") + c.latitude + "," + c.longitude + ",1,09,0.9,-412.3,M,-21.4,M,,");
    const auto d = decode(b);
    ASSERT_EQ(d.instants.size(), 1U);
    EXPECT_NEAR(d.instants[0].solution.latitude_deg, c.lat, 1e-12);
    EXPECT_NEAR(d.instants[0].solution.longitude_deg, c.lon, 1e-12);
    EXPECT_NEAR(d.instants[0].solution.height_m, -433.7, 1e-9);  // the Dead Sea
  }
  for (const char* beyond :
       {"9000.00001,N,00000.00000,E", "4800.00000,N,18000.00001,E", "4860.00000,N,00000.00000,E",
        "4800.00000,E,00000.00000,N", "-4800.0000,N,00000.00000,E", "4800.0x000,N,00000.00000,E"}) {
    Buffer b;
    append_sentence(b, std::string("GNGGA,120000.00,") + beyond + ",1,09,0.9,0,M,0,M,,");
    const auto d = decode(b);
    EXPECT_EQ(d.assembled.malformed, 1U) << beyond;
    EXPECT_TRUE(d.instants.empty()) << beyond;
  }
}

TEST(Epochs, ASolutionIsHandedOverWithItsLastMessageFromTheSecondInstantOn) {
  std::vector<int> handed;
  int message = 0;
  EpochAssembler a({}, {.solution = [&](const Solution&, BenchTime) { handed.push_back(message); },
                        .sky = {},
                        .pulse = {},
                        .raw = {}});
  MessageStream stream;
  for (int epoch = 0; epoch < 3; ++epoch)
    for (const char* text :
         {"GNRMC,12000%d.00,A,4800.00000,N,01100.00000,E,0.000,,020324,,,A,V", "GNVTG,,T,,M,0.0,N,0.0,K,A",
          "GNGGA,12000%d.00,4800.00000,N,01100.00000,E,1,05,2.0,500.0,M,47.0,M,,",
          "GNGSA,A,3,01,02,03,04,,,,,,,,,1.9,1.0,1.6,1", "GNGSA,A,3,65,66,,,,,,,,,,,1.9,1.0,1.6,2"}) {
      char line[128];
      std::snprintf(line, sizeof line, text, epoch);
      Buffer b;
      append_sentence(b, line);
      stream.add(b);
      a.take(*stream.next(), BenchTime(message));
      ++message;
    }
  // The first is known to be over when the second begins.
  EXPECT_EQ(handed, (std::vector<int>{5, 9, 14}));
}

TEST(Epochs, SatellitesAreThoseOfWholeGroupsOfSentences) {
  const auto d = decode(
      sentences({"GNRMC,120000.00,A,4800.00000,N,01100.00000,E,0.000,,020324,,,A,V",
                 "GNGSA,A,3,01,02,,,,,,,,,,,1.9,1.0,1.6,1", "GNGSA,A,3,05,,,,,,,,,,,,1.9,1.0,1.6,3",
                 "GPGSV,2,1,05,01,10,020,30,02,30,120,40,03,20,220,,33,05,180,20,1", "GPGSV,2,2,05,04,,,22,1",
                 "GLGSV,2,1,05,65,10,020,30,66,30,120,40,67,20,220,,68,05,180,20,1",  // its second is missing
                 "GAGSV,1,1,01,05,45,270,33,7", "GNGLL,4800.00000,N,01100.00000,E,120000.00,A,A"}));
  ASSERT_EQ(d.instants.size(), 1U);
  ASSERT_TRUE(d.instants[0].sky);
  const auto& v = d.instants[0].sky->satellites;
  ASSERT_EQ(v.size(), 6U);
  const int numbers[] = {1, 2, 3, 33, 4, 305};
  const bool used[] = {true, true, false, false, false, true};
  for (std::size_t i = 0; i < 6; ++i) {
    EXPECT_EQ(nmea_number(v[i].id), numbers[i]);
    EXPECT_EQ(v[i].used, used[i]) << i;
  }
  EXPECT_TRUE(std::isnan(v[2].cn0_dbhz));
  EXPECT_TRUE(std::isnan(v[4].azimuth_deg));
  EXPECT_EQ(v[3].id, (SatelliteId{Gnss::sbas, 120}));
  EXPECT_EQ(d.assembled.incomplete_groups, 1U);
}

TEST(Epochs, UbxWinsWhereBothProtocolsAreOnOneLine) {
  Buffer b;
  for (int i = 0; i < 3; ++i) {
    NavPvt v = pvt_at(static_cast<std::uint32_t>(1000 * i));
    v.latitude_e7 = 481234567;
    append_nav_pvt(b, v);
    append_sentence(
        b, "GNRMC,12000" + std::to_string(i) + ".00,A,4800.00000,N,01100.00000,E,0.000,,020324,,,A,V");
  }
  const auto d = decode(b);
  ASSERT_EQ(d.instants.size(), 3U);
  for (const auto& i : d.instants) EXPECT_NEAR(i.solution.latitude_deg, 48.1234567, 1e-12);
}

TEST(Epochs, CovarianceFineDigitsAndPulsesOfUbx) {
  Buffer b;
  NavPvt v = pvt_at(5000);
  v.flags = 1 | 2 | 2 << 6;
  v.longitude_e7 = -1213140779, v.latitude_e7 = 440688433;
  append_nav_pvt(b, v);
  NavHpposllh h;
  h.itow_ms = 5000, h.longitude_e7 = -1213140779, h.longitude_e9 = -62, h.latitude_e7 = 440688433,
  h.latitude_e9 = 73;
  h.height_mm = -12345, h.height_e4 = -6;
  append_nav_hpposllh(b, h);
  append_nav_cov(b, {5000, true, false, {4, 1, 2, 9, 3, 16}, {}});
  append_tim_tp(b, {6000, 1U << 31, -2500, 2303, 2, 0});
  Buffer raw;
  append_le(raw, 123456.5), append_le(raw, std::uint16_t{2303}), append_le(raw, std::int8_t{18}),
      append_le(raw, std::uint8_t{1}), append_zeros(raw, 36);
  append_ubx(b, UbxId::rxm_rawx, raw);
  const auto d = decode(b);
  ASSERT_EQ(d.instants.size(), 1U);
  const Solution& s = d.instants[0].solution;
  EXPECT_EQ(s.status, FixStatus::rtk_fixed);
  EXPECT_NEAR(s.longitude_deg, -121.314077962, 1e-12);
  EXPECT_NEAR(s.latitude_deg, 44.068843373, 1e-12);
  EXPECT_NEAR(s.height_m, -12.3456, 1e-9);
  // North, east, down to east, north, up.
  EXPECT_EQ(s.covariance_enu_m2, (std::array<double, 9>{9, 1, -3, 1, 4, -2, -3, -2, 16}));
  ASSERT_EQ(d.pulses.size(), 1U);
  EXPECT_EQ((d.pulses[0].t_device - s.t_device).ns(), 1'000'500'000);
  EXPECT_NEAR(d.pulses[0].quantization_ns, -2.5, 1e-12);
  ASSERT_EQ(d.raw.size(), 1U);
  EXPECT_EQ(d.raw[0], raw);
  EXPECT_EQ(d.leap_seconds, 18);
}

/// Messages come 80 to 120 ms after their instant; edges of the pulse within 20 µs.
/// Solutions of a receiver at 10 Hz, whose messages come 30 to 34 ms after their instants; those that a line
/// holds up from `from_s` on come together when it lets go.
std::vector<ReceiverStream::Place> places_on_a_line_held_up(double from_s, Duration held) {
  std::vector<ReceiverStream::Place> places;
  ReceiverStream::Options options;
  options.period = milliseconds(100);
  ReceiverStream stream(
      options, {.solution = [&](const Solution&, const ReceiverStream::Place& p) { places.push_back(p); },
                .sky = {},
                .pulse = {},
                .raw = {},
                .message = {}});
  const BenchTime stuck(std::llround(from_s * 1e9)), free = stuck + held;
  Buffer burst;
  for (std::uint32_t k = 0; k < 200; ++k) {
    const BenchTime due = BenchTime(0) + milliseconds(100) * k + milliseconds(30) + milliseconds(k * 7 % 5);
    Buffer b;
    append_nav_pvt(b, pvt_at(302'400'000 + 100 * k));
    if (due >= stuck && due < free) {
      burst.insert(burst.end(), b.begin(), b.end());
      continue;
    }
    if (!burst.empty() && due >= free) {
      // As a port reads it: pieces that end anywhere.
      for (std::size_t at = 0; at < burst.size(); at += 250)
        stream.take(Bytes(burst).subspan(at, std::min<std::size_t>(250, burst.size() - at)), free);
      burst.clear();
    }
    stream.take(b, due);
    stream.idle();
  }
  return places;
}

TEST(Epochs, ALineThatWasHeldUpTeachesTheClockNothing) {
  for (const double from_s : {0.0, 0.51, 1.5, 2.05, 4.0, 7.77, 12.0})
    for (const Duration held : {milliseconds(45), milliseconds(80), milliseconds(130), milliseconds(245),
                                milliseconds(940), milliseconds(2330)}) {
      const auto places = places_on_a_line_held_up(from_s, held);
      ASSERT_EQ(places.size(), 200U);
      for (std::size_t k = 1; k < places.size(); ++k) {
        const BenchTime truth = BenchTime(0) + milliseconds(100) * static_cast<std::int64_t>(k);
        if ((places[k].validity & kClockUnsure) != 0) {
          EXPECT_LT(k, 30U) << "held from " << from_s << " s";
          continue;
        }
        EXPECT_NEAR((places[k].t_capture - truth).seconds(), 0, 0.006)
            << k << ", held from " << from_s << " s for " << held.ns();
        if ((places[k - 1].validity & kClockUnsure) != 0) continue;
        EXPECT_NEAR((places[k].t_capture - places[k - 1].t_capture).seconds(), 0.1, 0.004)
            << k << ", held from " << from_s << " s for " << held.ns();
      }
    }
}

TEST(Epochs, AMessageThatComesInPiecesIsOfItsFirstByte) {
  std::vector<BenchTime> arrivals;
  ReceiverStream stream(
      {},
      {.solution = [&](const Solution&, const ReceiverStream::Place& p) { arrivals.push_back(p.arrival); },
       .sky = {},
       .pulse = {},
       .raw = {},
       .message = {}});
  Buffer first, second;
  append_nav_pvt(first, pvt_at(302'400'000));
  append_nav_pvt(second, pvt_at(302'500'000));
  const auto take = [&](Bytes b, std::int64_t ms) { stream.take(b, BenchTime(ms * 1'000'000)); };
  take(Bytes(first).first(3), 100);
  take(Bytes(first).subspan(3, 40), 120);
  Buffer tail(first.begin() + 43, first.end());
  tail.insert(tail.end(), second.begin(), second.begin() + 10);
  take(tail, 140);
  take(Bytes(second).subspan(10), 160);
  stream.finish();
  EXPECT_EQ(arrivals, (std::vector{BenchTime(100'000'000), BenchTime(140'000'000)}));
}

TEST(Epochs, APulseTiesStampsDownFromMillisecondsToMicroseconds) {
  for (const bool with_edges : {false, true}) {
    double worst_us = 0, sigma_us = 0;
    std::int64_t truth_ns = 0;
    ReceiverStream::Options options;
    options.output_delay = milliseconds(80);
    options.period = milliseconds(200);
    ReceiverStream stream(options,
                          {.solution =
                               [&](const Solution&, const ReceiverStream::Place& p) {
                                 worst_us = std::abs(static_cast<double>(p.t_capture.ns() - truth_ns)) * 1e-3;
                                 sigma_us = static_cast<double>(p.sigma.ns()) * 1e-3;
                               },
                           .sky = {},
                           .pulse = {},
                           .raw = {},
                           .message = {}});
    for (int k = 0; k < 300; ++k) {
      truth_ns = 7'000'000'000 + k * 200'000'000LL;
      const std::uint32_t itow = 100'000U + static_cast<std::uint32_t>(k) * 200;
      if (with_edges && k % 5 == 0)
        stream.take_edge(BenchTime(truth_ns - 20'000 + k * 37 % 15'000), BenchTime(truth_ns + 20'000));
      Buffer b;
      append_nav_pvt(b, pvt_at(itow));
      if (k % 5 == 4) append_tim_tp(b, {itow + 200, 0, 0, 2303, 2, 0});
      stream.take(b, BenchTime(truth_ns + 80'000'000 + k * 7919 % 40'000'000));
      stream.idle();
    }
    if (with_edges) {
      EXPECT_LT(worst_us, 25);
      EXPECT_LT(sigma_us, 50);
      EXPECT_GT(stream.counters().edges, 50U);
    } else {
      EXPECT_LT(worst_us, 12'000);
      EXPECT_GT(sigma_us, 1000);
    }
    EXPECT_EQ(stream.counters().solutions_lost, 0U);
  }
}

}  // namespace
}  // namespace rigor::gnss
