#include "drivers/gnss/ubx.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>

#include "rt-core/byte_order.h"

namespace rigor::gnss {
namespace {

constexpr std::uint8_t kSync1 = 0xB5, kSync2 = 0x62;

std::string fixed_text(Bytes field) {
  const auto end = std::find(field.begin(), field.end(), std::uint8_t{0});
  return {field.begin(), end};
}
void put_fixed_text(Buffer& out, const std::string& text, std::size_t size) {
  for (std::size_t i = 0; i < size; ++i)
    out.push_back(i < text.size() && i + 1 < size ? static_cast<std::uint8_t>(text[i]) : 0);
}

}  // namespace

std::array<std::uint8_t, 2> ubx_checksum(Bytes bytes) noexcept {
  std::uint8_t a = 0, b = 0;
  for (const std::uint8_t v : bytes) {
    a = static_cast<std::uint8_t>(a + v);
    b = static_cast<std::uint8_t>(b + a);
  }
  return {a, b};
}

void append_ubx(Buffer& out, UbxId id, Bytes payload) {
  const std::size_t begin = out.size();
  const auto code = static_cast<std::uint16_t>(id);
  append_le(out, kSync1);
  append_le(out, kSync2);
  append_le(out, static_cast<std::uint8_t>(code >> 8));
  append_le(out, static_cast<std::uint8_t>(code));
  append_le(out, static_cast<std::uint16_t>(payload.size()));
  out.insert(out.end(), payload.begin(), payload.end());
  const auto sum = ubx_checksum(Bytes(out).subspan(begin + 2));
  out.insert(out.end(), sum.begin(), sum.end());
}

std::optional<NavPvt> parse_nav_pvt(Bytes p) noexcept {
  if (p.size() < 84) return {};
  NavPvt v;
  v.itow_ms = load_le<std::uint32_t>(p, 0);
  v.year = load_le<std::uint16_t>(p, 4);
  v.month = p[6], v.day = p[7], v.hour = p[8], v.minute = p[9], v.second = p[10];
  v.valid = p[11];
  v.time_accuracy_ns = load_le<std::uint32_t>(p, 12);
  v.nano = load_le<std::int32_t>(p, 16);
  v.fix_type = p[20], v.flags = p[21], v.flags2 = p[22], v.satellites = p[23];
  v.longitude_e7 = load_le<std::int32_t>(p, 24);
  v.latitude_e7 = load_le<std::int32_t>(p, 28);
  v.height_mm = load_le<std::int32_t>(p, 32);
  v.height_msl_mm = load_le<std::int32_t>(p, 36);
  v.horizontal_accuracy_mm = load_le<std::uint32_t>(p, 40);
  v.vertical_accuracy_mm = load_le<std::uint32_t>(p, 44);
  v.north_mmps = load_le<std::int32_t>(p, 48);
  v.east_mmps = load_le<std::int32_t>(p, 52);
  v.down_mmps = load_le<std::int32_t>(p, 56);
  v.ground_speed_mmps = load_le<std::int32_t>(p, 60);
  v.heading_e5 = load_le<std::int32_t>(p, 64);
  v.speed_accuracy_mmps = load_le<std::uint32_t>(p, 68);
  v.heading_accuracy_e5 = load_le<std::uint32_t>(p, 72);
  v.pdop_e2 = load_le<std::uint16_t>(p, 76);
  v.flags3 = load_le<std::uint16_t>(p, 78);
  return v;
}

void append_nav_pvt(Buffer& out, const NavPvt& v) {
  Buffer p;
  append_le(p, v.itow_ms), append_le(p, v.year);
  for (const std::uint8_t b : {v.month, v.day, v.hour, v.minute, v.second, v.valid}) append_le(p, b);
  append_le(p, v.time_accuracy_ns), append_le(p, v.nano);
  for (const std::uint8_t b : {v.fix_type, v.flags, v.flags2, v.satellites}) append_le(p, b);
  for (const std::int32_t i : {v.longitude_e7, v.latitude_e7, v.height_mm, v.height_msl_mm}) append_le(p, i);
  append_le(p, v.horizontal_accuracy_mm), append_le(p, v.vertical_accuracy_mm);
  for (const std::int32_t i : {v.north_mmps, v.east_mmps, v.down_mmps, v.ground_speed_mmps, v.heading_e5})
    append_le(p, i);
  append_le(p, v.speed_accuracy_mmps), append_le(p, v.heading_accuracy_e5), append_le(p, v.pdop_e2),
      append_le(p, v.flags3);
  append_zeros(p, 12);  // reserved, heading of the vehicle, magnetic declination
  append_ubx(out, UbxId::nav_pvt, p);
}

bool parse_nav_sat(Bytes p, NavSat& out) noexcept {
  if (p.size() < 8 || p.size() < 8 + std::size_t{p[5]} * 12) return false;
  out.itow_ms = load_le<std::uint32_t>(p, 0);
  out.count = p[5];
  for (std::size_t i = 0; i < out.count; ++i) {
    const Bytes e = p.subspan(8 + 12 * i, 12);
    out.satellite[i] = {e[0],
                        e[1],
                        e[2],
                        load_le<std::int8_t>(e, 3),
                        load_le<std::int16_t>(e, 4),
                        load_le<std::int16_t>(e, 6),
                        load_le<std::uint32_t>(e, 8)};
  }
  return true;
}

void append_nav_sat(Buffer& out, const NavSat& s) {
  Buffer p;
  append_le(p, s.itow_ms), append_le(p, std::uint8_t{1}), append_le(p, s.count), append_zeros(p, 2);
  for (std::size_t i = 0; i < s.count; ++i) {
    const NavSatEntry& e = s.satellite[i];
    append_le(p, e.gnss), append_le(p, e.satellite), append_le(p, e.cn0_dbhz), append_le(p, e.elevation_deg),
        append_le(p, e.azimuth_deg), append_le(p, e.residual_dm), append_le(p, e.flags);
  }
  append_ubx(out, UbxId::nav_sat, p);
}

std::optional<NavDop> parse_nav_dop(Bytes p) noexcept {
  if (p.size() < 18) return {};
  return NavDop{load_le<std::uint32_t>(p, 0),  load_le<std::uint16_t>(p, 4),  load_le<std::uint16_t>(p, 6),
                load_le<std::uint16_t>(p, 8),  load_le<std::uint16_t>(p, 10), load_le<std::uint16_t>(p, 12),
                load_le<std::uint16_t>(p, 14), load_le<std::uint16_t>(p, 16)};
}

void append_nav_dop(Buffer& out, const NavDop& d) {
  Buffer p;
  append_le(p, d.itow_ms);
  for (const std::uint16_t v : {d.geometric_e2, d.position_e2, d.time_e2, d.vertical_e2, d.horizontal_e2,
                                d.northing_e2, d.easting_e2})
    append_le(p, v);
  append_ubx(out, UbxId::nav_dop, p);
}

std::optional<NavCov> parse_nav_cov(Bytes p) noexcept {
  if (p.size() < 64) return {};
  NavCov c;
  c.itow_ms = load_le<std::uint32_t>(p, 0);
  c.position_valid = p[5] == 1, c.velocity_valid = p[6] == 1;
  for (std::size_t i = 0; i < 6; ++i) {
    c.position_m2[i] = load_le<float>(p, 16 + 4 * i);
    c.velocity_m2ps2[i] = load_le<float>(p, 40 + 4 * i);
    c.position_valid &= std::isfinite(c.position_m2[i]);
    c.velocity_valid &= std::isfinite(c.velocity_m2ps2[i]);
  }
  return c;
}

void append_nav_cov(Buffer& out, const NavCov& c) {
  Buffer p;
  append_le(p, c.itow_ms), append_le(p, std::uint8_t{0}), append_le(p, std::uint8_t{c.position_valid}),
      append_le(p, std::uint8_t{c.velocity_valid}), append_zeros(p, 9);
  for (const float v : c.position_m2) append_le(p, v);
  for (const float v : c.velocity_m2ps2) append_le(p, v);
  append_ubx(out, UbxId::nav_cov, p);
}

std::optional<NavHpposllh> parse_nav_hpposllh(Bytes p) noexcept {
  if (p.size() < 36) return {};
  NavHpposllh h;
  h.invalid = (p[3] & 1) != 0;
  h.itow_ms = load_le<std::uint32_t>(p, 4);
  h.longitude_e7 = load_le<std::int32_t>(p, 8);
  h.latitude_e7 = load_le<std::int32_t>(p, 12);
  h.height_mm = load_le<std::int32_t>(p, 16);
  h.height_msl_mm = load_le<std::int32_t>(p, 20);
  h.longitude_e9 = load_le<std::int8_t>(p, 24);
  h.latitude_e9 = load_le<std::int8_t>(p, 25);
  h.height_e4 = load_le<std::int8_t>(p, 26);
  h.height_msl_e4 = load_le<std::int8_t>(p, 27);
  h.horizontal_accuracy_e4 = load_le<std::uint32_t>(p, 28);
  h.vertical_accuracy_e4 = load_le<std::uint32_t>(p, 32);
  return h;
}

void append_nav_hpposllh(Buffer& out, const NavHpposllh& h) {
  Buffer p;
  append_zeros(p, 3), append_le(p, std::uint8_t{h.invalid}), append_le(p, h.itow_ms);
  for (const std::int32_t v : {h.longitude_e7, h.latitude_e7, h.height_mm, h.height_msl_mm}) append_le(p, v);
  for (const std::int8_t v : {h.longitude_e9, h.latitude_e9, h.height_e4, h.height_msl_e4}) append_le(p, v);
  append_le(p, h.horizontal_accuracy_e4), append_le(p, h.vertical_accuracy_e4);
  append_ubx(out, UbxId::nav_hpposllh, p);
}

std::optional<NavTimeGps> parse_nav_timegps(Bytes p) noexcept {
  if (p.size() < 16) return {};
  return NavTimeGps{load_le<std::uint32_t>(p, 0), load_le<std::int32_t>(p, 4), load_le<std::int16_t>(p, 8),
                    load_le<std::int8_t>(p, 10), p[11]};
}

void append_nav_timegps(Buffer& out, const NavTimeGps& t) {
  Buffer p;
  append_le(p, t.itow_ms), append_le(p, t.fraction_ns), append_le(p, t.week), append_le(p, t.leap_seconds),
      append_le(p, t.valid);
  append_le(p, std::uint32_t{20});  // accuracy, ns
  append_ubx(out, UbxId::nav_timegps, p);
}

std::optional<std::uint32_t> parse_nav_eoe(Bytes p) noexcept {
  if (p.size() < 4) return {};
  return load_le<std::uint32_t>(p, 0);
}
void append_nav_eoe(Buffer& out, std::uint32_t itow_ms) {
  Buffer p;
  append_le(p, itow_ms);
  append_ubx(out, UbxId::nav_eoe, p);
}

std::optional<TimTp> parse_tim_tp(Bytes p) noexcept {
  if (p.size() < 16) return {};
  return TimTp{load_le<std::uint32_t>(p, 0),
               load_le<std::uint32_t>(p, 4),
               load_le<std::int32_t>(p, 8),
               load_le<std::uint16_t>(p, 12),
               p[14],
               p[15]};
}
void append_tim_tp(Buffer& out, const TimTp& t) {
  Buffer p;
  append_le(p, t.tow_ms), append_le(p, t.tow_sub_ms_e32), append_le(p, t.quantization_ps),
      append_le(p, t.week), append_le(p, t.flags), append_le(p, t.reference);
  append_ubx(out, UbxId::tim_tp, p);
}

std::optional<RawxHead> parse_rawx(Bytes p) noexcept {
  if (p.size() < 16 || p.size() < 16 + 32 * std::size_t{p[11]}) return {};
  return RawxHead{load_le<double>(p, 0), load_le<std::uint16_t>(p, 8), load_le<std::int8_t>(p, 10), p[11]};
}

std::optional<UbxId> parse_ack(Bytes p) noexcept {
  if (p.size() < 2) return {};
  return ubx_id(p[0], p[1]);
}
void append_ack(Buffer& out, bool good, UbxId about) {
  const auto code = static_cast<std::uint16_t>(about);
  const std::uint8_t p[2] = {static_cast<std::uint8_t>(code >> 8), static_cast<std::uint8_t>(code)};
  append_ubx(out, good ? UbxId::ack_ack : UbxId::ack_nak, p);
}

unsigned MonVer::generation() const {
  for (const std::string& e : extensions) {
    const auto at = e.find("PROTVER");
    if (at == std::string::npos) continue;
    const char* number = e.c_str() + at + 7;
    while (*number == '=' || *number == ' ') ++number;
    const double version = std::strtod(number, nullptr);
    return version >= 23.01 ? 9 : version > 0 ? 8 : 0;
  }
  return 0;
}

std::optional<MonVer> parse_mon_ver(Bytes p) {
  if (p.size() < 40) return {};
  MonVer v{fixed_text(p.first(30)), fixed_text(p.subspan(30, 10)), {}};
  for (std::size_t at = 40; at + 30 <= p.size(); at += 30)
    v.extensions.push_back(fixed_text(p.subspan(at, 30)));
  return v;
}
void append_mon_ver(Buffer& out, const MonVer& v) {
  Buffer p;
  put_fixed_text(p, v.software, 30);
  put_fixed_text(p, v.hardware, 10);
  for (const std::string& e : v.extensions) put_fixed_text(p, e, 30);
  append_ubx(out, UbxId::mon_ver, p);
}

std::size_t config_value_bytes(std::uint32_t key) noexcept {
  switch (key >> 28 & 7) {
    case 1:  // one bit
    case 2:
      return 1;
    case 3:
      return 2;
    case 4:
      return 4;
    case 5:
      return 8;
    default:
      return 0;
  }
}

void append_valset(Buffer& out, std::span<const ConfigItem> items) {
  Buffer p{0, 1, 0, 0};  // version, layer RAM
  for (const ConfigItem& i : items) {
    append_le(p, i.key);
    for (std::size_t b = 0; b < config_value_bytes(i.key); ++b)
      p.push_back(static_cast<std::uint8_t>(i.value >> (8 * b)));
  }
  append_ubx(out, UbxId::cfg_valset, p);
}

std::optional<std::vector<ConfigItem>> parse_valset(Bytes p) {
  if (p.size() < 4) return {};
  std::vector<ConfigItem> items;
  for (p = p.subspan(4); !p.empty();) {
    if (p.size() < 4) return {};
    ConfigItem item{load_le<std::uint32_t>(p, 0), 0};
    const std::size_t size = config_value_bytes(item.key);
    if (size == 0 || p.size() < 4 + size || items.size() == 64) return {};
    for (std::size_t b = 0; b < size; ++b) item.value |= std::uint64_t{p[4 + b]} << (8 * b);
    items.push_back(item);
    p = p.subspan(4 + size);
  }
  return items;
}

std::optional<CfgPort> parse_cfg_prt(Bytes p) noexcept {
  if (p.size() < 20) return {};
  return CfgPort{p[0], load_le<std::uint32_t>(p, 4), load_le<std::uint32_t>(p, 8),
                 load_le<std::uint16_t>(p, 12), load_le<std::uint16_t>(p, 14)};
}
void append_cfg_prt(Buffer& out, const CfgPort& c) {
  Buffer p;
  append_le(p, c.port), append_zeros(p, 3), append_le(p, c.mode), append_le(p, c.baud), append_le(p, c.in),
      append_le(p, c.out), append_zeros(p, 4);
  append_ubx(out, UbxId::cfg_prt, p);
}

std::optional<std::pair<UbxId, std::uint8_t>> parse_cfg_msg(Bytes p) noexcept {
  if (p.size() == 3) return std::pair{ubx_id(p[0], p[1]), p[2]};
  if (p.size() == 8) return std::pair{ubx_id(p[0], p[1]), p[3]};  // by port: I2C, UART1, …
  return {};
}
void append_cfg_msg(Buffer& out, UbxId message, std::uint8_t rate) {
  const auto code = static_cast<std::uint16_t>(message);
  const std::uint8_t p[3] = {static_cast<std::uint8_t>(code >> 8), static_cast<std::uint8_t>(code), rate};
  append_ubx(out, UbxId::cfg_msg, p);
}

std::optional<std::uint16_t> parse_cfg_rate(Bytes p) noexcept {
  if (p.size() < 6) return {};
  return load_le<std::uint16_t>(p, 0);
}
void append_cfg_rate(Buffer& out, std::uint16_t period_ms) {
  Buffer p;
  append_le(p, period_ms), append_le(p, std::uint16_t{1}),
      append_le(p, std::uint16_t{1});  // each one, in GPS time
  append_ubx(out, UbxId::cfg_rate, p);
}

}  // namespace rigor::gnss
