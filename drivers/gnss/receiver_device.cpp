#include "drivers/gnss/receiver_device.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace rigor::gnss {
namespace {

template <class T>
T rounded(double v) {
  if (!std::isfinite(v)) return 0;
  using L = std::numeric_limits<T>;
  return static_cast<T>(
      std::llround(std::clamp(v, static_cast<double>(L::min()), static_cast<double>(L::max()))));
}

}  // namespace

Dilution dilution_of(const Sky& sky) noexcept {
  // Gauss–Jordan on [GᵀG | I].
  std::array<std::array<double, 8>, 4> m{};
  unsigned used = 0;
  for (const Satellite& v : sky.satellites) {
    if (!v.used || !std::isfinite(v.elevation_deg) || !std::isfinite(v.azimuth_deg)) continue;
    ++used;
    const double el = v.elevation_deg * kRadPerDeg, az = v.azimuth_deg * kRadPerDeg;
    const std::array<double, 4> g{std::cos(el) * std::sin(az), std::cos(el) * std::cos(az), std::sin(el), 1};
    for (std::size_t i = 0; i < 4; ++i)
      for (std::size_t j = 0; j < 4; ++j) m[i][j] += g[i] * g[j];
  }
  Dilution d;
  if (used < 4) return d;
  for (std::size_t i = 0; i < 4; ++i) m[i][4 + i] = 1;
  for (std::size_t i = 0; i < 4; ++i) {
    std::size_t pivot = i;
    for (std::size_t k = i + 1; k < 4; ++k)
      if (std::abs(m[k][i]) > std::abs(m[pivot][i])) pivot = k;
    if (std::abs(m[pivot][i]) < 1e-9) return d;
    std::swap(m[i], m[pivot]);
    const double by = m[i][i];
    for (double& x : m[i]) x /= by;
    for (std::size_t k = 0; k < 4; ++k) {
      if (k == i) continue;
      const double times = m[k][i];
      for (std::size_t j = 0; j < 8; ++j) m[k][j] -= times * m[i][j];
    }
  }
  const double ee = m[0][4], nn = m[1][5], uu = m[2][6], tt = m[3][7];
  d = {std::sqrt(ee + nn + uu + tt), std::sqrt(ee + nn + uu), std::sqrt(tt), std::sqrt(uu),
       std::sqrt(ee + nn),           std::sqrt(nn),           std::sqrt(ee)};
  return d;
}

Sky made_sky(unsigned used) {
  Sky sky;
  constexpr unsigned kMore = 3;
  const unsigned all = std::min(used, 60U) + kMore;
  std::array<std::uint8_t, 7> next{};
  next.fill(1);
  for (unsigned k = 0; k < all; ++k) {
    Satellite v;
    v.id.gnss = k < 12 ? Gnss::gps : k % 3 == 0 ? Gnss::galileo : k % 3 == 1 ? Gnss::glonass : Gnss::beidou;
    v.id.satellite = next[static_cast<std::size_t>(v.id.gnss)]++;
    v.used = k < used;
    // Spread by the golden angle; those that are not used stand low.
    v.azimuth_deg = static_cast<float>((k * 137U + 20) % 360);
    v.elevation_deg = v.used ? static_cast<float>(15 + (k * 29U) % 70) : static_cast<float>(3 + k % 5);
    v.cn0_dbhz = v.used ? std::round(28 + v.elevation_deg / 5) : 18;
    sky.satellites.push_back(v);
  }
  return sky;
}

ReceiverDevice::ReceiverDevice(const EmulatorSettings& settings)
    : settings_(settings),
      period_(settings.period),
      baud_(settings.baud),
      high_precision_(settings.high_precision),
      rates_(output_messages().size(), 0) {
  for (std::size_t i = 0; i < rates_.size(); ++i)
    if (std::find(settings.messages.begin(), settings.messages.end(), output_messages()[i].name) !=
        settings.messages.end())
      rates_[i] = 1;
}

ReceiverDevice::Counters ReceiverDevice::counters() const {
  Counters c = counters_;
  c.malformed = host_.counters().bad_checksums + host_.counters().bad_lengths;
  return c;
}

bool ReceiverDevice::due(std::string_view message, std::uint64_t index) const {
  for (std::size_t i = 0; i < rates_.size(); ++i)
    if (message == output_messages()[i].name) {
      const bool out = output_messages()[i].nmea ? nmea_out_ : ubx_out_;
      return out && rates_[i] > 0 && index % rates_[i] == 0;
    }
  return false;
}

bool ReceiverDevice::set_rate(UbxId id, std::uint8_t rate) {
  for (std::size_t i = 0; i < rates_.size(); ++i) {
    const OutputMessage& m = output_messages()[i];
    if (m.id != id) continue;
    // There are no measurements of ranges in the model; and generation 8 knows no covariance.
    if (rate > 0 && (m.id == UbxId::rxm_rawx || (m.id == UbxId::nav_cov && settings_.generation < 9)))
      return false;
    rates_[i] = rate;
    return true;
  }
  return rate == 0;
}

bool ReceiverDevice::set_item(const ConfigItem& item) {
  const std::uint32_t key = item.key;
  if (key == config_key::kRateMeasurement) {
    if (item.value < 25 || item.value > 10000) return false;
    period_ = milliseconds(static_cast<std::int64_t>(item.value));
    return true;
  }
  if (key == config_key::kRateNavigation) return item.value == 1;
  if (key == config_key::kNmeaHighPrecision) {
    high_precision_ = item.value != 0;
    return true;
  }
  if ((key & ~0x10000U) == config_key::kUart1Baud) {
    if (!serial::is_standard_baud(static_cast<unsigned>(item.value))) return false;
    baud_ = static_cast<unsigned>(item.value);
    return true;
  }
  const std::uint32_t group = key & 0xFFFF0000U, protocol = key & 0xFFFF;
  if (group >= 0x10730000U && group <= 0x10780000U) {
    // Odd groups are inputs: what comes in is always read.
    if ((group & 0x10000U) == 0) {
      if (protocol == 1) ubx_out_ = item.value != 0;
      if (protocol == 2) nmea_out_ = item.value != 0;
    }
    return true;
  }
  for (const OutputMessage& m : output_messages())
    if (key >= m.key && key <= m.key + 4) return set_rate(m.id, static_cast<std::uint8_t>(item.value));
  return false;
}

bool ReceiverDevice::configure(const Message& m) {
  if (m.ubx == UbxId::cfg_valset && settings_.generation >= 9) {
    const auto items = parse_valset(m.payload);
    if (!items) return false;
    // All or nothing.
    const auto rates = rates_;
    const auto period = period_;
    for (const ConfigItem& i : *items)
      if (!set_item(i)) {
        rates_ = rates;
        period_ = period;
        return false;
      }
    return true;
  }
  // Those of generation 8 are taken by receivers of protocol 27, too.
  if (m.ubx == UbxId::cfg_rate) {
    const auto ms = parse_cfg_rate(m.payload);
    if (!ms || *ms < 25) return false;
    period_ = milliseconds(*ms);
    return true;
  }
  if (m.ubx == UbxId::cfg_msg) {
    const auto rate = parse_cfg_msg(m.payload);
    return rate && set_rate(rate->first, rate->second);
  }
  if (m.ubx == UbxId::cfg_prt) {
    const auto port = parse_cfg_prt(m.payload);
    if (!port || (port->port != 3 && !serial::is_standard_baud(port->baud))) return false;
    if (port->port != 3) baud_ = port->baud;
    ubx_out_ = (port->out & 1) != 0;
    nmea_out_ = (port->out & 2) != 0;
    return true;
  }
  return false;
}

void ReceiverDevice::receive(Bytes bytes, BenchTime now) {
  host_.add(bytes);
  while (const auto m = host_.next()) {
    if (m->kind == Message::Kind::rtcm) {
      ++counters_.rtcm;
      corrected_at_ = now;
      continue;
    }
    if (m->kind != Message::Kind::ubx) continue;
    ++counters_.requests;
    if (m->ubx == UbxId::mon_ver && m->payload.empty()) {
      append_mon_ver(output_, settings_.generation >= 9
                                  ? MonVer{"EXT CORE 1.00 (RIGOR)",
                                           "00190000",
                                           {"FWVER=HPG 1.32", "PROTVER=27.31", "MOD=ZED-F9P"}}
                                  : MonVer{"ROM CORE 3.01 (RIGOR)",
                                           "00080000",
                                           {"FWVER=SPG 3.01", "PROTVER=18.00", "MOD=NEO-M8N-0"}});
      continue;
    }
    if (static_cast<std::uint16_t>(m->ubx) >> 8 != 0x06) continue;  // other polls are not answered
    const bool good = configure(*m);
    counters_.refused += !good;
    append_ack(output_, good, m->ubx);
  }
}

void ReceiverDevice::speak(const Measured& measured, RealtimeTime utc, std::uint64_t index, BenchTime now) {
  const NavFix& f = measured.fix;
  Solution s;
  s.utc = RealtimeTime(utc.ns() - settings_.week_rollovers * 1024 * kWeek_ns);
  s.status = f.status;
  const bool kept = settings_.corrections_timeout.ns() <= 0 ||
                    (corrected_at_ && now - *corrected_at_ <= settings_.corrections_timeout);
  if (s.status > FixStatus::fix && !kept) s.status = FixStatus::fix;
  s.corrected = s.status > FixStatus::fix;
  s.satellites_used = s.has_fix() ? f.satellites : 0;
  const Sky sky = made_sky(s.satellites_used);
  const Dilution d = dilution_of(sky);
  s.pdop = d.position, s.hdop = d.horizontal, s.vdop = d.vertical;
  if (s.has_fix()) {
    s.mode = Solution::Mode::fix_3d;
    s.latitude_deg = f.latitude_deg, s.longitude_deg = f.longitude_deg;
    s.height_m = f.height_m, s.height_msl_m = f.height_m - settings_.geoid_separation_m;
    s.covariance_enu_m2 = f.covariance_enu_m2;
    s.velocity_enu_mps = measured.velocity_enu_mps;
    s.speed_mps = std::hypot(s.velocity_enu_mps[0], s.velocity_enu_mps[1]);
    const double course = std::atan2(s.velocity_enu_mps[0], s.velocity_enu_mps[1]) / kRadPerDeg;
    s.course_deg = course < 0 ? course + 360 : course;
    s.velocity_sigma_mps = std::sqrt(3.0) * settings_.velocity_sigma_mps;
    if (corrected_at_ && s.corrected) s.correction_age_s = (now - *corrected_at_).seconds();
  }
  s.time_sigma = nanoseconds(20);
  solution_ = s;
  speak_ubx(sky, d, index, gps_time(*s.utc, settings_.leap_seconds));
  speak_nmea(sky, index);
}

void ReceiverDevice::speak_ubx(const Sky& sky, const Dilution& d, std::uint64_t index, GpsTime gps) {
  const Solution& s = solution_;
  // To the millisecond, as receivers have it; the rest is in `nano`.
  const std::int64_t tow_ms = (gps.tow_ns + 500'000) / 1'000'000;
  const auto itow = static_cast<std::uint32_t>(tow_ms % (kWeek_ns / 1'000'000));
  const double sigma_h = std::sqrt(std::max(0.0, s.covariance_enu_m2[0] + s.covariance_enu_m2[4]));
  const double sigma_v = std::sqrt(std::max(0.0, s.covariance_enu_m2[8]));
  if (due("pvt", index)) {
    NavPvt v;
    v.itow_ms = itow;
    // The date of the whole millisecond; what is left is below it.
    const UtcTime u = utc_time(*s.utc);
    v.year = static_cast<std::uint16_t>(u.year), v.month = static_cast<std::uint8_t>(u.month);
    v.day = static_cast<std::uint8_t>(u.day), v.hour = static_cast<std::uint8_t>(u.hour);
    v.minute = static_cast<std::uint8_t>(u.minute), v.second = static_cast<std::uint8_t>(u.second);
    v.valid = 7;
    v.nano = static_cast<std::int32_t>(u.nanosecond);
    v.time_accuracy_ns = static_cast<std::uint32_t>(s.time_sigma.ns());
    v.fix_type = s.has_fix() ? 3 : 0;
    v.flags = s.has_fix() ? 1 : 0;
    if (s.corrected) v.flags |= 2;
    if (s.status == FixStatus::rtk_float) v.flags |= 1 << 6;
    if (s.status == FixStatus::rtk_fixed) v.flags |= 2 << 6;
    v.satellites = static_cast<std::uint8_t>(std::min<unsigned>(s.satellites_used, 255));
    v.flags3 = s.has_fix() ? 0 : 1;
    v.longitude_e7 = rounded<std::int32_t>(s.longitude_deg * 1e7);
    v.latitude_e7 = rounded<std::int32_t>(s.latitude_deg * 1e7);
    v.height_mm = rounded<std::int32_t>(s.height_m * 1e3);
    v.height_msl_mm = rounded<std::int32_t>(s.height_msl_m * 1e3);
    v.horizontal_accuracy_mm = s.has_fix() ? rounded<std::uint32_t>(sigma_h * 1e3) : 0xFFFFFFFF;
    v.vertical_accuracy_mm = s.has_fix() ? rounded<std::uint32_t>(sigma_v * 1e3) : 0xFFFFFFFF;
    v.north_mmps = rounded<std::int32_t>(s.velocity_enu_mps[1] * 1e3);
    v.east_mmps = rounded<std::int32_t>(s.velocity_enu_mps[0] * 1e3);
    v.down_mmps = rounded<std::int32_t>(s.velocity_enu_mps[2] * -1e3);
    v.ground_speed_mmps = rounded<std::int32_t>(s.speed_mps * 1e3);
    v.heading_e5 = rounded<std::int32_t>(s.course_deg * 1e5);
    v.speed_accuracy_mmps = rounded<std::uint32_t>(s.velocity_sigma_mps * 1e3);
    v.pdop_e2 = std::isfinite(d.position) ? rounded<std::uint16_t>(d.position * 100) : 9999;
    append_nav_pvt(output_, v);
  }
  if (due("hpposllh", index) && s.has_fix()) {
    const auto split = [](double value, double coarse, double fine, std::int32_t& whole, std::int8_t& rest) {
      const auto all = std::llround(value / fine);
      const auto ratio = std::llround(coarse / fine);
      const auto w = all / ratio;
      whole = static_cast<std::int32_t>(w);
      rest = static_cast<std::int8_t>(all - w * ratio);
    };
    NavHpposllh h;
    h.itow_ms = itow;
    split(s.longitude_deg, 1e-7, 1e-9, h.longitude_e7, h.longitude_e9);
    split(s.latitude_deg, 1e-7, 1e-9, h.latitude_e7, h.latitude_e9);
    split(s.height_m, 1e-3, 1e-4, h.height_mm, h.height_e4);
    split(s.height_msl_m, 1e-3, 1e-4, h.height_msl_mm, h.height_msl_e4);
    h.horizontal_accuracy_e4 = rounded<std::uint32_t>(sigma_h * 1e4);
    h.vertical_accuracy_e4 = rounded<std::uint32_t>(sigma_v * 1e4);
    append_nav_hpposllh(output_, h);
  }
  if (due("cov", index)) {
    NavCov c;
    c.itow_ms = itow;
    c.position_valid = s.has_fix();
    c.velocity_valid = s.has_fix();
    if (s.has_fix()) {
      const auto& e = s.covariance_enu_m2;
      const double of[6] = {e[4], e[1], -e[5], e[0], -e[2], e[8]};
      for (std::size_t i = 0; i < 6; ++i) c.position_m2[i] = static_cast<float>(of[i]);
      const auto v2 = static_cast<float>(settings_.velocity_sigma_mps * settings_.velocity_sigma_mps);
      c.velocity_m2ps2 = {v2, 0, 0, v2, 0, v2};
    }
    append_nav_cov(output_, c);
  }
  const auto e2 = [](double v) {
    return std::isfinite(v) ? rounded<std::uint16_t>(v * 100) : std::uint16_t{9999};
  };
  if (due("dop", index))
    append_nav_dop(output_, {itow, e2(d.geometric), e2(d.position), e2(d.time), e2(d.vertical),
                             e2(d.horizontal), e2(d.northing), e2(d.easting)});
  if (due("sat", index)) {
    NavSat sat;
    sat.itow_ms = itow;
    sat.count = static_cast<std::uint8_t>(sky.satellites.size());
    for (std::size_t i = 0; i < sky.satellites.size(); ++i) {
      const Satellite& v = sky.satellites[i];
      sat.satellite[i] = {static_cast<std::uint8_t>(v.id.gnss),     v.id.satellite,
                          static_cast<std::uint8_t>(v.cn0_dbhz),    static_cast<std::int8_t>(v.elevation_deg),
                          static_cast<std::int16_t>(v.azimuth_deg), 0,
                          v.used ? 7U | 8U | 16U : 4U | 16U};
    }
    append_nav_sat(output_, sat);
  }
  if (due("timegps", index))
    append_nav_timegps(
        output_, {itow, static_cast<std::int32_t>(gps.tow_ns - tow_ms * 1'000'000),
                  static_cast<std::int16_t>(gps.week), static_cast<std::int8_t>(settings_.leap_seconds), 7});
  if (due("eoe", index)) append_nav_eoe(output_, itow);
  // The pulse of the next full second is announced once, less than a second before it.
  const std::int64_t to_second = 1'000'000'000 - gps.tow_ns % 1'000'000'000;
  if (due("tim_tp", 0) && to_second <= period_.ns()) {
    TimTp t;
    const std::int64_t at = (gps.tow_ns + to_second) % kWeek_ns;
    t.tow_ms = static_cast<std::uint32_t>(at / 1'000'000);
    t.week = static_cast<std::uint16_t>(gps.week + (gps.tow_ns + to_second) / kWeek_ns);
    t.flags = 2;  // GNSS time; UTC is known
    append_tim_tp(output_, t);
  }
}

void ReceiverDevice::speak_nmea(const Sky& sky, std::uint64_t index) {
  if (!nmea_out_) return;
  const NmeaDigits digits = high_precision_ ? NmeaDigits{7, 3, 2} : NmeaDigits{};
  sentences_.clear();
  append_solution_sentences(sentences_, solution_, sky, digits);
  // Those that are switched on, each with its end of line.
  std::size_t begin = 0;
  bool with_sky = due("gsv", index);
  const auto add_sky = [&] {
    if (std::exchange(with_sky, false)) append_sky_sentences(output_, sky);
  };
  for (std::size_t i = 0; i < sentences_.size(); ++i) {
    if (sentences_[i] != '\n') continue;
    std::string name(sentences_.begin() + static_cast<std::ptrdiff_t>(begin) + 3,
                     sentences_.begin() + static_cast<std::ptrdiff_t>(begin) + 6);
    for (char& c : name) c = static_cast<char>(c - 'A' + 'a');
    if (name == "gll") add_sky();  // behind GSA, as u-blox has it
    if (due(name, index))
      output_.insert(output_.end(), sentences_.begin() + static_cast<std::ptrdiff_t>(begin),
                     sentences_.begin() + static_cast<std::ptrdiff_t>(i) + 1);
    begin = i + 1;
  }
  add_sky();
}

}  // namespace rigor::gnss
