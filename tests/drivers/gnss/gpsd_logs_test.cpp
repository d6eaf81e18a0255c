// Logs of u-blox receivers, decoded here and by gpsd: what gpsd's regression tests expect of each log lies
// beside it (.chk, one JSON object a line) as test data.
//
// Compared for each instant: time, mode, differential status, latitude, longitude, altitude above the
// ellipsoid and above mean sea level, speed over ground, course, estimated errors where the receiver
// told them, dilution of precision, and of every satellite in view its constellation and number, elevation,
// azimuth, C/N0 and whether it was used. Not compared: magnetic variation (gpsd has a model of the Earth's
// field), climb (in gpsd the difference of two altitudes, also where the receiver tells its velocity), and of
// NMEA without GST epx, epy, eph, epv, sep, eps and epc, which gpsd makes from dilution of precision and a
// range error of its own (19 m).
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <map>
#include <nlohmann/json.hpp>
#include <sstream>

#include "drivers/gnss/epoch_assembler.h"
#include "tests/drivers/gnss/gnss_test_tools.h"

namespace rigor::gnss {
namespace {

using nlohmann::json;

/// What gpsd's expectations say of one instant: the last report of it, and the last list of satellites.
struct Expected {
  RealtimeTime utc;
  json tpv, sky;
};

RealtimeTime time_of(const std::string& iso) {
  int y = 0, mo = 0, d = 0, h = 0, mi = 0, s = 0, ms = 0;
  EXPECT_EQ(std::sscanf(iso.c_str(), "%d-%d-%dT%d:%d:%d.%dZ", &y, &mo, &d, &h, &mi, &s, &ms), 7) << iso;
  return realtime_of({y, mo, d, h, mi, s, ms * 1'000'000LL});
}

/// gpsd shows the sentences between its reports: of NMEA the time of the last one with a time is that of the
/// satellites which are reported next.
std::vector<Expected> read_expectations(const std::filesystem::path& file) {
  std::vector<Expected> all;
  std::ifstream in(file);
  std::int64_t of_day_ms = -1;
  std::map<std::int64_t, json> pending_sky;
  for (std::string line; std::getline(in, line);) {
    int h = 0, m = 0, s = 0;
    if (line.size() > 15 && std::sscanf(line.c_str() + 6, ",%2d%2d%2d.", &h, &m, &s) == 3)
      of_day_ms = ((h * 60 + m) * 60 + s) * 1000LL;
    if (line.empty() || line[0] != '{') continue;
    const json j = json::parse(line);
    if (j["class"] == "TPV" && j.contains("time")) {
      const RealtimeTime t = time_of(j["time"]);
      if (all.empty() || all.back().utc != t) all.push_back({t, {}, {}});
      all.back().tpv = j;
    } else if (j["class"] == "SKY" && j.contains("satellites")) {
      // The report of the instant itself may come later than its satellites.
      const std::int64_t at =
          j.contains("time") ? time_of(j["time"]).ns() / 1'000'000 % 86'400'000 : of_day_ms;
      pending_sky[at] = j;
    }
  }
  for (Expected& e : all)
    if (const auto it = pending_sky.find(e.utc.ns() / 1'000'000 % 86'400'000); it != pending_sky.end())
      e.sky = it->second;
  return all;
}

void expect_number(const json& j, const char* key, double got, double tolerance, const std::string& where) {
  if (!j.contains(key)) return;
  EXPECT_NEAR(got, j[key].get<double>(), tolerance) << where << " " << key;
}

/// gpsd's numbers of signals (those of UBX) from NMEA's: GPS and Galileo, L1 and L2.
int ubx_signal(const Satellite& v) {
  if (v.id.gnss == Gnss::gps || v.id.gnss == Gnss::sbas) return v.signal == 6 ? 3 : v.signal == 5 ? 4 : 0;
  if (v.id.gnss == Gnss::glonass) return v.signal == 3 ? 2 : 0;
  return v.signal == 7 ? 0 : v.signal;
}

struct Figures {
  int instants = 0, skies = 0, satellites = 0;
};

void compare_sky(const json& sky, const Sky& got, const std::string& where, Figures& f, bool by_ubx) {
  ++f.skies;
  ASSERT_EQ(sky["satellites"].size(), got.satellites.size()) << where;
  for (std::size_t i = 0; i < got.satellites.size(); ++i) {
    const json& want = sky["satellites"][i];
    const Satellite& v = got.satellites[i];
    const std::string which = where + " satellite " + want["PRN"].dump();
    EXPECT_EQ(nmea_number(v.id), want["PRN"].get<int>()) << which;
    EXPECT_EQ(static_cast<int>(v.id.gnss), want["gnssid"].get<int>()) << which;
    EXPECT_EQ(v.id.satellite, want["svid"].get<int>()) << which;
    if (!by_ubx && want.contains("sigid")) {
      EXPECT_EQ(ubx_signal(v), want["sigid"].get<int>()) << which;
    }
    EXPECT_EQ(std::isfinite(v.elevation_deg), want.contains("el")) << which;
    expect_number(want, "el", v.elevation_deg, 1e-6, which);
    expect_number(want, "az", v.azimuth_deg, 1e-6, which);
    EXPECT_EQ(std::isfinite(v.cn0_dbhz), want.contains("ss")) << which;
    expect_number(want, "ss", v.cn0_dbhz, 1e-6, which);
    EXPECT_EQ(v.used, want["used"].get<bool>()) << which;
    ++f.satellites;
  }
}

/// `broken`: sentences that were cut off when the log was made.
Figures compare(const std::string& name, bool by_ubx, std::uint64_t broken) {
  Figures f;
  const auto folder = test::logs();
  const auto expected = read_expectations(folder / (name + ".log.chk"));
  const test::Decoded got = test::decode(test::read_file(folder / (name + ".log")));
  EXPECT_EQ(got.counters.bad_checksums, broken);
  EXPECT_EQ(got.assembled.malformed, 0U);
  std::map<std::int64_t, const test::Decoded::Instant*> by_time;
  for (const auto& i : got.instants)
    if (i.solution.utc) by_time[i.solution.utc->ns()] = &i;
  for (const Expected& e : expected) {
    const std::string where = name + " " + e.tpv["time"].get<std::string>();
    // gpsd shows milliseconds.
    const auto it = by_time.lower_bound(e.utc.ns() - 600'000);
    if (it == by_time.end() || it->first > e.utc.ns() + 1'100'000) {
      ADD_FAILURE() << where << ": not decoded";
      continue;
    }
    const Solution& s = it->second->solution;
    ++f.instants;
    const int mode = s.mode == Solution::Mode::fix_3d ? 3 : s.mode == Solution::Mode::fix_2d ? 2 : 1;
    EXPECT_EQ(mode, e.tpv["mode"].get<int>()) << where;
    EXPECT_EQ(s.status == FixStatus::sbas, e.tpv.value("status", 1) == 2) << where;
    expect_number(e.tpv, "lat", s.latitude_deg, 0.6e-9, where);
    expect_number(e.tpv, "lon", s.longitude_deg, 0.6e-9, where);
    expect_number(e.tpv, "altHAE", s.height_m, 0.6e-3, where);
    expect_number(e.tpv, "altMSL", s.height_msl_m, 0.6e-3, where);
    expect_number(e.tpv, "speed", s.speed_mps, 0.6e-3, where);
    expect_number(e.tpv, "track", s.course_deg, 0.6e-4, where);
    if (by_ubx) {
      expect_number(e.tpv, "eph", std::sqrt(s.covariance_enu_m2[0] + s.covariance_enu_m2[4]), 0.6e-3, where);
      expect_number(e.tpv, "epv", std::sqrt(s.covariance_enu_m2[8]), 0.6e-3, where);
      EXPECT_EQ(got.leap_seconds, e.tpv["leapseconds"].get<int>()) << where;
    }
    if (!e.sky.is_null() && it->second->sky) {
      if (!by_ubx) {
        expect_number(e.sky, "hdop", s.hdop, 1e-9, where);
        expect_number(e.sky, "pdop", s.pdop, 1e-9, where);
        expect_number(e.sky, "vdop", s.vdop, 1e-9, where);
      }
      compare_sky(e.sky, *it->second->sky, where, f, by_ubx);
    }
  }
  return f;
}

TEST(GpsdLogs, NmeaOfAMaxM8q) {
  RIGOR_NEEDS_GNSS_LOGS();
  const Figures f = compare("ublox-8", false, 1);
  EXPECT_EQ(f.instants, 72);
  EXPECT_EQ(f.skies, 72);
  EXPECT_EQ(f.satellites, 1800);
}

TEST(GpsdLogs, HighPrecisionNmeaOfAZedF9p) {
  RIGOR_NEEDS_GNSS_LOGS();
  const Figures f = compare("ublox-f9p-hpnmea", false, 0);
  EXPECT_EQ(f.instants, 9);
  EXPECT_EQ(f.skies, 7);
  EXPECT_EQ(f.satellites, 185);
}

TEST(GpsdLogs, UbxOfANeoM8n) {
  RIGOR_NEEDS_GNSS_LOGS();
  const Figures f = compare("ublox-neo-m8n", true, 0);
  EXPECT_EQ(f.instants, 22);
  EXPECT_EQ(f.skies, 4);  // of a fifth the instant is beyond the end of the log
  EXPECT_EQ(f.satellites, 112);
}

}  // namespace
}  // namespace rigor::gnss
