#include "drivers/gnss/nmea.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdarg>
#include <cstdio>

#include "drivers/gnss/gnss_time.h"

namespace rigor::gnss {
namespace {

constexpr double kKnot_mps = 1852.0 / 3600;

/// Reads fields one after the other; what is no value makes all of it bad.
class Reader {
 public:
  explicit Reader(const Sentence& s) : s_(s) {}
  [[nodiscard]] bool good() const { return good_; }
  [[nodiscard]] double number(std::size_t i) {
    const std::string_view f = s_[i];
    if (f.empty()) return kUnknown;
    double v = 0;
    const auto [end, error] = std::from_chars(f.data(), f.data() + f.size(), v);
    if (error != std::errc() || end != f.data() + f.size() || !std::isfinite(v))
      return good_ = false, kUnknown;
    return v;
  }
  /// Digits alone.
  [[nodiscard]] int whole(std::size_t i, int missing = 0) { return digits(s_[i], missing); }
  [[nodiscard]] std::optional<TimeOfDay> time(std::size_t i) {
    const std::string_view f = s_[i];
    if (f.empty()) return {};
    if (f.size() < 6) return good_ = false, std::nullopt;
    const int hour = digits(f.substr(0, 2)), minute = digits(f.substr(2, 2)), second = digits(f.substr(4, 2));
    std::int64_t fraction_ns = 0;
    if (f.size() > 6) {
      if (f[6] != '.' || f.size() > 16) return good_ = false, std::nullopt;
      std::int64_t unit = kSecond_ns / 10;
      for (const char c : f.substr(7)) {
        if (c < '0' || c > '9') return good_ = false, std::nullopt;
        fraction_ns += (c - '0') * unit;
        unit /= 10;
      }
    }
    if (hour > 23 || minute > 59 || second > 60 || (second == 60 && (hour != 23 || minute != 59)))
      good_ = false;
    if (!good_) return {};
    return TimeOfDay{((hour * 60 + minute) * 60 + second) * kSecond_ns + fraction_ns, second == 60};
  }
  /// ddmmyy. Two digits of a year: from 1980, when GPS began, to 2079.
  [[nodiscard]] std::optional<Date> date(std::size_t i) {
    const std::string_view f = s_[i];
    if (f.empty()) return {};
    if (f.size() != 6) return good_ = false, std::nullopt;
    const int year = digits(f.substr(4, 2));
    return checked({year < 80 ? 2000 + year : 1900 + year, digits(f.substr(2, 2)), digits(f.substr(0, 2))});
  }
  [[nodiscard]] std::optional<Date> checked(Date d) {
    if (!good_ || !is_date(d.year, d.month, d.day)) return good_ = false, std::nullopt;
    return d;
  }
  /// Four fields: dddmm.mmm, hemisphere, twice.
  [[nodiscard]] NmeaPlace place(std::size_t i) {
    if (s_[i].empty() && s_[i + 2].empty()) return {};
    return {angle(i, 'N', 'S', 90), angle(i + 2, 'E', 'W', 180)};
  }
  [[nodiscard]] char letter(std::size_t i) { return s_[i].size() == 1 ? s_[i][0] : '\0'; }

 private:
  [[nodiscard]] int digits(std::string_view f, int missing = 0) {
    if (f.empty()) return missing;
    int v = 0;
    const auto [end, error] = std::from_chars(f.data(), f.data() + f.size(), v);
    if (error != std::errc() || end != f.data() + f.size() || v < 0) return good_ = false, 0;
    return v;
  }
  [[nodiscard]] double angle(std::size_t i, char positive, char negative, double most_deg) {
    const std::string_view f = s_[i];
    const auto point = std::min(f.find('.'), f.size());
    const char side = letter(i + 1);
    if (point < 3 || (side != positive && side != negative)) return good_ = false, kUnknown;
    const int degrees = digits(f.substr(0, point - 2));
    double minutes = 0;
    const auto [end, error] = std::from_chars(f.data() + point - 2, f.data() + f.size(), minutes);
    const double deg = degrees + minutes / 60;
    if (error != std::errc() || end != f.data() + f.size() || !(minutes >= 0 && minutes < 60) ||
        !(deg <= most_deg))
      return good_ = false, kUnknown;
    return side == positive ? deg : -deg;
  }
  const Sentence& s_;
  bool good_ = true;
};

template <class T>
std::optional<T> if_good(const Reader& r, const T& value) {
  return r.good() ? std::optional<T>(value) : std::nullopt;
}

/// What a number in a sentence of this talker, or of this system (NMEA 4.10), means.
SatelliteId satellite_of(std::string_view talker, int system, int number) noexcept {
  const auto id = [](Gnss g, int n) {
    return SatelliteId{g, static_cast<std::uint8_t>(n > 0 && n < 255 ? n : 0)};
  };
  if (number > 400) return id(Gnss::beidou, number - 400);
  if (number > 300) return id(Gnss::galileo, number - 300);
  const bool told = system > 0;
  if (told ? system == 3 : talker == "GA") return id(Gnss::galileo, number);
  if (told ? system == 4 : talker == "GB" || talker == "BD")
    return id(Gnss::beidou, number > 200 ? number - 200 : number);
  if (told ? system == 5 : talker == "GQ") return id(Gnss::qzss, number > 192 ? number - 192 : number);
  if (number >= 193) return id(Gnss::qzss, number - 192);
  if (number >= 120) return id(Gnss::sbas, number);
  if (number > 64) return id(Gnss::glonass, number - 64);
  if (told ? system == 2 : talker == "GL") return id(Gnss::glonass, number);
  if (number > 32) return id(Gnss::sbas, number + 87);
  return id(Gnss::gps, number);
}

}  // namespace

std::optional<Sentence> split_sentence(std::string_view text) noexcept {
  Sentence s;
  const auto comma = text.find(',');
  if (comma != 5 || text[0] == 'P') return {};
  s.talker = text.substr(0, 2);
  s.formatter = text.substr(2, 3);
  text.remove_prefix(6);
  while (true) {
    if (s.fields == Sentence::kMaxFields) return {};
    const auto end = text.find(',');
    s.field[s.fields++] = text.substr(0, end);
    if (end == std::string_view::npos) return s;
    text.remove_prefix(end + 1);
  }
}

std::optional<Gga> parse_gga(const Sentence& s) noexcept {
  Reader r(s);
  Gga g;
  g.time = r.time(0);
  g.place = r.place(1);
  g.quality = r.whole(5);
  g.satellites = r.whole(6);
  g.hdop = r.number(7);
  g.height_msl_m = r.number(8);
  g.geoid_separation_m = r.number(10);
  g.correction_age_s = r.number(12);
  if (s.fields < 12 || g.satellites > 255) return {};
  return if_good(r, g);
}

std::optional<Rmc> parse_rmc(const Sentence& s) noexcept {
  Reader r(s);
  Rmc m;
  m.time = r.time(0);
  m.valid = r.letter(1) == 'A';
  m.place = r.place(2);
  m.speed_mps = r.number(6) * kKnot_mps;
  m.course_deg = r.number(7);
  m.date = r.date(8);
  m.mode = r.letter(11);
  if (s.fields < 9) return {};
  return if_good(r, m);
}

std::optional<Gll> parse_gll(const Sentence& s) noexcept {
  Reader r(s);
  Gll g;
  g.place = r.place(0);
  g.time = r.time(4);
  g.valid = r.letter(5) == 'A';
  if (s.fields < 6) return {};
  return if_good(r, g);
}

std::optional<Vtg> parse_vtg(const Sentence& s) noexcept {
  Reader r(s);
  Vtg v;
  v.course_deg = r.number(0);
  v.speed_mps = r.number(4) * kKnot_mps;
  if (s.fields < 8) return {};
  return if_good(r, v);
}

std::optional<Gst> parse_gst(const Sentence& s) noexcept {
  Reader r(s);
  Gst g;
  g.time = r.time(0);
  g.sigma_latitude_m = r.number(5);
  g.sigma_longitude_m = r.number(6);
  g.sigma_height_m = r.number(7);
  if (s.fields < 8) return {};
  return if_good(r, g);
}

std::optional<Zda> parse_zda(const Sentence& s) noexcept {
  Reader r(s);
  Zda z;
  z.time = r.time(0);
  if (!s[1].empty() || !s[2].empty() || !s[3].empty())
    z.date = r.checked({r.whole(3), r.whole(2), r.whole(1)});
  if (s.fields < 4) return {};
  return if_good(r, z);
}

std::optional<Gsa> parse_gsa(const Sentence& s) noexcept {
  Reader r(s);
  Gsa g;
  g.mode = r.whole(1, 1);
  const int system = s.fields > 17 && !s[17].empty() ? r.whole(17) : 0;
  for (std::size_t i = 0; i < g.used.size(); ++i)
    if (const int n = r.whole(2 + i); n > 0) g.used[g.count++] = satellite_of(s.talker, system, n);
  g.pdop = r.number(14);
  g.hdop = r.number(15);
  g.vdop = r.number(16);
  if (s.fields < 15 || g.mode < 1 || g.mode > 3) return {};
  return if_good(r, g);
}

std::optional<Gsv> parse_gsv(const Sentence& s) noexcept {
  Reader r(s);
  Gsv g;
  g.total = r.whole(0);
  g.number = r.whole(1);
  if (s.fields < 3 || g.number < 1 || g.number > g.total || g.total > 64) return {};
  const std::size_t groups = std::min<std::size_t>((s.fields - 3) / 4, g.satellite.size());
  if ((s.fields - 3) % 4 == 1) {
    // Hexadecimal, by the standard.
    const std::string_view f = s[s.fields - 1];
    const auto [end, error] = std::from_chars(f.data(), f.data() + f.size(), g.signal, 16);
    if (!f.empty() && (error != std::errc() || end != f.data() + f.size() || g.signal > 15)) return {};
  }
  for (std::size_t i = 0; i < groups; ++i) {
    const std::size_t at = 3 + 4 * i;
    const int number = r.whole(at, -1);
    if (number < 0) continue;  // a group that fills the sentence up, or a satellite that is not identified
    Satellite v;
    v.id = satellite_of(s.talker, 0, number);
    v.signal = static_cast<std::uint8_t>(g.signal);
    v.elevation_deg = static_cast<float>(r.number(at + 1));
    v.azimuth_deg = static_cast<float>(r.number(at + 2));
    v.cn0_dbhz = static_cast<float>(r.number(at + 3));
    g.satellite[g.count++] = v;
  }
  return if_good(r, g);
}

void append_sentence(Buffer& out, std::string_view text) {
  std::uint8_t sum = 0;
  for (const char c : text) sum ^= static_cast<std::uint8_t>(c);
  constexpr char kHex[] = "0123456789ABCDEF";
  out.push_back('$');
  out.insert(out.end(), text.begin(), text.end());
  for (const char c : {'*', kHex[sum >> 4], kHex[sum & 15], '\r', '\n'})
    out.push_back(static_cast<std::uint8_t>(c));
}

namespace {

class Writer {
 public:
  explicit Writer(const char* address) : text_(address) {}
  Writer& add(std::string_view field) {
    text_ += ',';
    text_ += field;
    return *this;
  }
  [[gnu::format(printf, 2, 3)]] Writer& addf(const char* format, ...) {
    char buffer[64];
    va_list list;
    va_start(list, format);
    std::vsnprintf(buffer, sizeof buffer, format, list);
    va_end(list);
    return add(buffer);
  }
  /// Empty where it is not known.
  Writer& number(double v, int digits) { return std::isfinite(v) ? addf("%.*f", digits, v) : add(""); }
  Writer& angle(double deg, int degree_digits, int minute_digits, char positive, char negative) {
    // Whole units of the last digit, so that no minute is ever 60.
    std::int64_t unit = 1;
    for (int i = 0; i < minute_digits; ++i) unit *= 10;
    const std::int64_t all = std::llround(std::abs(deg) * 60 * static_cast<double>(unit));
    const std::int64_t minutes = all % (60 * unit);
    addf("%0*lld%02lld.%0*lld", degree_digits, static_cast<long long>(all / (60 * unit)),
         static_cast<long long>(minutes / unit), minute_digits, static_cast<long long>(minutes % unit));
    const char side[2] = {deg < 0 ? negative : positive, '\0'};
    return add(side);
  }
  Writer& place(const Solution& s, int digits) {
    if (!s.has_fix()) return add("").add("").add("").add("");
    return angle(s.latitude_deg, 2, digits, 'N', 'S').angle(s.longitude_deg, 3, digits, 'E', 'W');
  }
  Writer& time(const UtcTime& t, int digits) {
    std::int64_t unit = kSecond_ns;
    for (int i = 0; i < digits; ++i) unit /= 10;
    return addf("%02d%02d%02d.%0*lld", t.hour, t.minute, t.second, digits,
                static_cast<long long>(t.nanosecond / unit));
  }
  void finish(Buffer& out) const { append_sentence(out, text_); }

 private:
  std::string text_;
};

const char* mode_letter(const Solution& s) {
  if (!s.has_fix()) return "N";
  if (s.status == FixStatus::rtk_fixed) return "R";
  if (s.status == FixStatus::rtk_float) return "F";
  return s.corrected ? "D" : "A";
}
int quality_of(const Solution& s) {
  if (!s.has_fix()) return 0;
  if (s.status == FixStatus::rtk_fixed) return 4;
  if (s.status == FixStatus::rtk_float) return 5;
  return s.corrected ? 2 : 1;
}

struct Group {
  const char* talker;
  int system;  ///< of GSA and GSV in NMEA 4.10
};
constexpr std::array<std::pair<Gnss, Group>, 6> kGroups{{{Gnss::gps, {"GP", 1}},
                                                         {Gnss::sbas, {"GP", 1}},
                                                         {Gnss::glonass, {"GL", 2}},
                                                         {Gnss::galileo, {"GA", 3}},
                                                         {Gnss::beidou, {"GB", 4}},
                                                         {Gnss::qzss, {"GQ", 5}}}};

Group group_of(Gnss g) {
  for (const auto& [gnss, group] : kGroups)
    if (gnss == g) return group;
  return {"GP", 1};
}
/// The number in a sentence of the satellite's own constellation: NMEA 4.11, strict.
int number_in_group(SatelliteId id) {
  return id.gnss == Gnss::galileo || id.gnss == Gnss::beidou || id.gnss == Gnss::qzss ? id.satellite
                                                                                      : nmea_number(id);
}

}  // namespace

void append_solution_sentences(Buffer& out, const Solution& s, const Sky& sky, const NmeaDigits& d) {
  const std::optional<UtcTime> utc = s.utc ? std::optional(utc_time(*s.utc)) : std::nullopt;
  const auto time = [&](Writer& w) -> Writer& { return utc ? w.time(*utc, d.time) : w.add(""); };
  const bool fix = s.has_fix();
  const auto when_fixed = [&](double v) { return fix ? v : kUnknown; };

  Writer rmc("GNRMC");
  time(rmc).add(fix ? "A" : "V").place(s, d.minutes);
  rmc.number(when_fixed(s.speed_mps / kKnot_mps), 3).number(when_fixed(s.course_deg), 2);
  if (utc)
    rmc.addf("%02d%02d%02d", utc->day, utc->month, utc->year % 100);
  else
    rmc.add("");
  rmc.add("").add("").add(mode_letter(s)).add("V").finish(out);

  Writer vtg("GNVTG");
  vtg.number(when_fixed(s.course_deg), 2).add("T").add("").add("M");
  vtg.number(when_fixed(s.speed_mps / kKnot_mps), 3).add("N");
  vtg.number(when_fixed(s.speed_mps * 3.6), 3).add("K").add(mode_letter(s)).finish(out);

  Writer gga("GNGGA");
  time(gga).place(s, d.minutes).addf("%d", quality_of(s)).addf("%02d", std::min<int>(s.satellites_used, 12));
  gga.number(s.hdop, 2).number(when_fixed(s.height_msl_m), d.height).add("M");
  gga.number(when_fixed(s.height_m - s.height_msl_m), d.height).add("M");
  gga.number(s.correction_age_s, 1).add("").finish(out);

  const int mode = !fix ? 1 : s.mode == Solution::Mode::fix_2d ? 2 : 3;
  for (int system = 1; system <= 5; ++system) {
    std::vector<int> used;
    bool known = false;
    for (const Satellite& v : sky.satellites) {
      if (group_of(v.id.gnss).system != system) continue;
      known = true;
      const int number = number_in_group(v.id);
      if (v.used && std::find(used.begin(), used.end(), number) == used.end()) used.push_back(number);
    }
    if (!known && system > 1) continue;
    Writer gsa("GNGSA");
    gsa.add("A").addf("%d", mode);
    for (std::size_t i = 0; i < 12; ++i)
      if (i < used.size())
        gsa.addf("%02d", used[i]);
      else
        gsa.add("");
    gsa.number(s.pdop, 2).number(s.hdop, 2).number(s.vdop, 2).addf("%d", system).finish(out);
  }

  Writer gll("GNGLL");
  gll.place(s, d.minutes);
  time(gll).add(fix ? "A" : "V").add(mode_letter(s)).finish(out);

  const auto sigma = [&](std::size_t i) {
    return fix && std::isfinite(s.covariance_enu_m2[4 * i]) ? std::sqrt(s.covariance_enu_m2[4 * i])
                                                            : kUnknown;
  };
  Writer gst("GNGST");
  time(gst).add("").add("").add("").add("");
  gst.number(sigma(1), 3).number(sigma(0), 3).number(sigma(2), 3).finish(out);

  Writer zda("GNZDA");
  if (utc)
    time(zda).addf("%02d", utc->day).addf("%02d", utc->month).addf("%04d", utc->year);
  else
    zda.add("").add("").add("").add("");
  zda.add("00").add("00").finish(out);
}

void append_sky_sentences(Buffer& out, const Sky& sky) {
  for (int system = 1; system <= 5; ++system) {
    std::vector<const Satellite*> of;
    for (const Satellite& v : sky.satellites)
      if (group_of(v.id.gnss).system == system) of.push_back(&v);
    if (of.empty()) continue;
    const std::size_t total = (of.size() + 3) / 4;
    for (std::size_t k = 0; k < total; ++k) {
      Writer gsv((std::string(group_of(of[0]->id.gnss).talker) + "GSV").c_str());
      gsv.addf("%zu", total).addf("%zu", k + 1).addf("%02zu", of.size());
      for (std::size_t i = 4 * k; i < std::min(of.size(), 4 * k + 4); ++i) {
        const Satellite& v = *of[i];
        gsv.addf("%02d", number_in_group(v.id));
        if (std::isfinite(v.elevation_deg))
          gsv.addf("%02d", static_cast<int>(std::lround(v.elevation_deg)));
        else
          gsv.add("");
        // Three digits; rounding up to 360 is north.
        if (std::isfinite(v.azimuth_deg))
          gsv.addf("%03d", static_cast<int>(std::lround(v.azimuth_deg)) % 360);
        else
          gsv.add("");
        if (std::isfinite(v.cn0_dbhz))
          gsv.addf("%02d", static_cast<int>(std::lround(v.cn0_dbhz)));
        else
          gsv.add("");
      }
      gsv.add("1").finish(out);
    }
  }
}

}  // namespace rigor::gnss
