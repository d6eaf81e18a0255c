// UBX, the binary protocol of u-blox receivers: frames, and the messages that Rigor reads and writes. No
// socket, no clock. Source: u-blox, "Receiver description including protocol specification" UBX-13003221
// (M8, protocol 15 to 23) and "F9 HPG 1.32 interface description" UBX-22008968 (protocol 27).
//
//   frame   0xB5 0x62, class, id, length (16 bits, little-endian), payload, checksum over class to payload
//
// Values keep the units of the protocol (`1e-7 deg`, mm) in these structs; solution.h has SI units.
#pragma once

#include <array>
#include <optional>
#include <string>
#include <utility>

#include "drivers/gnss/bytes.h"

namespace rigor::gnss {

/// Class in the upper byte.
enum class UbxId : std::uint16_t {
  nav_pvt = 0x0107,
  nav_dop = 0x0104,
  nav_hpposllh = 0x0114,
  nav_timegps = 0x0120,
  nav_sat = 0x0135,
  nav_cov = 0x0136,
  nav_eoe = 0x0161,
  rxm_rawx = 0x0215,
  ack_nak = 0x0500,
  ack_ack = 0x0501,
  cfg_prt = 0x0600,
  cfg_msg = 0x0601,
  cfg_rate = 0x0608,
  cfg_valset = 0x068A,
  cfg_valget = 0x068B,
  mon_ver = 0x0A04,
  tim_tp = 0x0D01,
};
[[nodiscard]] constexpr UbxId ubx_id(std::uint8_t message_class, std::uint8_t id) {
  return static_cast<UbxId>(message_class << 8 | id);
}

/// The longest payload that is taken for one: RXM-RAWX with 255 measurements. A frame that says more is a
/// length that lies.
inline constexpr std::size_t kMaxUbxPayload = 16 + 32 * 255;
inline constexpr std::size_t kUbxOverhead = 8;

/// The checksum of RFC 1145 as UBX has it, over class, id, length and payload.
[[nodiscard]] std::array<std::uint8_t, 2> ubx_checksum(Bytes bytes) noexcept;
/// Appends a whole frame. Precondition: at most kMaxUbxPayload bytes.
void append_ubx(Buffer& out, UbxId id, Bytes payload);

struct NavPvt {
  std::uint32_t itow_ms = 0;
  std::uint16_t year = 0;
  std::uint8_t month = 0, day = 0, hour = 0, minute = 0, second = 0;
  std::uint8_t valid = 0;  ///< 1 date, 2 time, 4 fully resolved
  std::uint32_t time_accuracy_ns = 0;
  std::int32_t nano = 0;      ///< of the second, −1e9 to 1e9
  std::uint8_t fix_type = 0;  ///< 0 none, 1 dead reckoning, 2 2D, 3 3D, 4 with dead reckoning, 5 time only
  std::uint8_t flags = 0;     ///< 1 fix is good, 2 with corrections, bits 6 and 7 carrier: 1 float, 2 fixed
  std::uint8_t flags2 = 0;
  std::uint8_t satellites = 0;
  std::int32_t longitude_e7 = 0, latitude_e7 = 0, height_mm = 0, height_msl_mm = 0;
  std::uint32_t horizontal_accuracy_mm = 0, vertical_accuracy_mm = 0;
  std::int32_t north_mmps = 0, east_mmps = 0, down_mmps = 0, ground_speed_mmps = 0, heading_e5 = 0;
  std::uint32_t speed_accuracy_mmps = 0, heading_accuracy_e5 = 0;
  std::uint16_t pdop_e2 = 0, flags3 = 0;
};
/// Empty: too short to be one. M7 receivers send 84 bytes, later ones 92.
[[nodiscard]] std::optional<NavPvt> parse_nav_pvt(Bytes payload) noexcept;
void append_nav_pvt(Buffer& out, const NavPvt& pvt);

struct NavSatEntry {
  std::uint8_t gnss = 0, satellite = 0, cn0_dbhz = 0;
  std::int8_t elevation_deg = 0;
  std::int16_t azimuth_deg = 0, residual_dm = 0;
  std::uint32_t flags = 0;  ///< bits 0 to 2 quality, 8 used, bits 4 and 5 health
};
struct NavSat {
  std::uint32_t itow_ms = 0;
  std::uint8_t count = 0;
  std::array<NavSatEntry, 255> satellite{};
};
[[nodiscard]] bool parse_nav_sat(Bytes payload, NavSat& out) noexcept;
void append_nav_sat(Buffer& out, const NavSat& sat);

struct NavDop {
  std::uint32_t itow_ms = 0;
  std::uint16_t geometric_e2 = 0, position_e2 = 0, time_e2 = 0, vertical_e2 = 0, horizontal_e2 = 0,
                northing_e2 = 0, easting_e2 = 0;
};
[[nodiscard]] std::optional<NavDop> parse_nav_dop(Bytes payload) noexcept;
void append_nav_dop(Buffer& out, const NavDop& dop);

/// Covariances in north, east, down; NN, NE, ND, EE, ED, DD.
struct NavCov {
  std::uint32_t itow_ms = 0;
  bool position_valid = false, velocity_valid = false;
  std::array<float, 6> position_m2{}, velocity_m2ps2{};
};
[[nodiscard]] std::optional<NavCov> parse_nav_cov(Bytes payload) noexcept;
void append_nav_cov(Buffer& out, const NavCov& cov);

struct NavHpposllh {
  std::uint32_t itow_ms = 0;
  bool invalid = false;
  std::int32_t longitude_e7 = 0, latitude_e7 = 0, height_mm = 0, height_msl_mm = 0;
  std::int8_t longitude_e9 = 0, latitude_e9 = 0, height_e4 = 0, height_msl_e4 = 0;  ///< to be added
  std::uint32_t horizontal_accuracy_e4 = 0, vertical_accuracy_e4 = 0;               ///< 0.1 mm
};
[[nodiscard]] std::optional<NavHpposllh> parse_nav_hpposllh(Bytes payload) noexcept;
void append_nav_hpposllh(Buffer& out, const NavHpposllh& p);

struct NavTimeGps {
  std::uint32_t itow_ms = 0;
  std::int32_t fraction_ns = 0;
  std::int16_t week = 0;
  std::int8_t leap_seconds = 0;
  std::uint8_t valid = 0;  ///< 1 time of week, 2 week, 4 leap seconds
};
[[nodiscard]] std::optional<NavTimeGps> parse_nav_timegps(Bytes payload) noexcept;
void append_nav_timegps(Buffer& out, const NavTimeGps& t);

[[nodiscard]] std::optional<std::uint32_t> parse_nav_eoe(Bytes payload) noexcept;  ///< time of week, ms
void append_nav_eoe(Buffer& out, std::uint32_t itow_ms);

/// Of the next time pulse, sent before it.
struct TimTp {
  std::uint32_t tow_ms = 0, tow_sub_ms_e32 = 0;  ///< 2⁻³² ms
  std::int32_t quantization_ps = 0;
  std::uint16_t week = 0;
  std::uint8_t flags = 0;  ///< 1 time base UTC (else GNSS), 2 UTC available, 16 quantization error unknown
  std::uint8_t reference = 0;
};
[[nodiscard]] std::optional<TimTp> parse_tim_tp(Bytes payload) noexcept;
void append_tim_tp(Buffer& out, const TimTp& tp);

/// The head of RXM-RAWX; its measurements stay bytes (32 each).
struct RawxHead {
  double receiver_tow_s = 0;
  std::uint16_t week = 0;
  std::int8_t leap_seconds = 0;
  std::uint8_t measurements = 0;
};
[[nodiscard]] std::optional<RawxHead> parse_rawx(Bytes payload) noexcept;

/// What an ACK-ACK or ACK-NAK is about.
[[nodiscard]] std::optional<UbxId> parse_ack(Bytes payload) noexcept;
void append_ack(Buffer& out, bool good, UbxId about);

struct MonVer {
  std::string software, hardware;
  std::vector<std::string> extensions;
  /// The generation by its protocol version ("PROTVER=27.31"): 9 from 23.01 on; 0: it does not tell.
  [[nodiscard]] unsigned generation() const;
};
[[nodiscard]] std::optional<MonVer> parse_mon_ver(Bytes payload);
void append_mon_ver(Buffer& out, const MonVer& version);

/// Keys of CFG-VALSET: group and item of the interface description; bits 28 to 30 say the size of the value.
struct ConfigItem {
  std::uint32_t key = 0;
  std::uint64_t value = 0;
};
/// Bytes of a key's value: 1, 2, 4 or 8; 0: no such size.
[[nodiscard]] std::size_t config_value_bytes(std::uint32_t key) noexcept;
/// At most 64 items, into RAM. Precondition: keys have sizes.
void append_valset(Buffer& out, std::span<const ConfigItem> items);
/// Empty: not well formed.
[[nodiscard]] std::optional<std::vector<ConfigItem>> parse_valset(Bytes payload);

namespace config_key {
inline constexpr std::uint32_t kRateMeasurement = 0x30210001;  ///< ms
inline constexpr std::uint32_t kRateNavigation = 0x30210002;   ///< measurements for each solution
inline constexpr std::uint32_t kUart1Baud = 0x40520001;
inline constexpr std::uint32_t kNmeaHighPrecision = 0x10930006;
/// Protocols in and out of a port, with the port's group added: UBX 1, NMEA 2, RTCM 3 is 4.
inline constexpr std::uint32_t kUart1In = 0x10730000, kUart1Out = 0x10740000, kUsbIn = 0x10770000,
                               kUsbOut = 0x10780000;
/// Output rates are consecutive: I2C, UART1, UART2, USB, SPI; these are of I2C.
inline constexpr std::uint32_t kOutPvt = 0x20910006, kOutSat = 0x20910015, kOutDop = 0x20910038,
                               kOutCov = 0x20910083, kOutTimeGps = 0x20910047, kOutEoe = 0x2091015F,
                               kOutHpposllh = 0x20910033, kOutRawx = 0x209102A4, kOutTimTp = 0x2091017D;
inline constexpr std::uint32_t kOutGga = 0x209100BA, kOutGll = 0x209100C9, kOutGsa = 0x209100BF,
                               kOutGsv = 0x209100C4, kOutRmc = 0x209100AB, kOutVtg = 0x209100B0,
                               kOutGst = 0x209100D3, kOutZda = 0x209100D8;
}  // namespace config_key

/// Generation 8: CFG-PRT of a UART or of USB, CFG-MSG for the port that it comes in by, CFG-RATE.
struct CfgPort {
  std::uint8_t port = 1;  ///< 1 UART1, 3 USB
  std::uint32_t mode = 0x8D0, baud = 0;
  std::uint16_t in = 0, out = 0;  ///< protocols: 1 UBX, 2 NMEA, 32 RTCM 3
};
[[nodiscard]] std::optional<CfgPort> parse_cfg_prt(Bytes payload) noexcept;
void append_cfg_prt(Buffer& out, const CfgPort& port);
/// Message and how many solutions there are for each of it; 0: none.
[[nodiscard]] std::optional<std::pair<UbxId, std::uint8_t>> parse_cfg_msg(Bytes payload) noexcept;
void append_cfg_msg(Buffer& out, UbxId message, std::uint8_t rate);
[[nodiscard]] std::optional<std::uint16_t> parse_cfg_rate(Bytes payload) noexcept;  ///< ms
void append_cfg_rate(Buffer& out, std::uint16_t period_ms);

}  // namespace rigor::gnss
