#include "drivers/velodyne/velodyne_packet.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdio>
#include <cstring>

#include "rt-core/byte_order.h"

namespace rigor::velodyne {
namespace {

constexpr std::size_t kBlockBytes = 100;
constexpr std::size_t kPositionTime = 198, kPositionPps = 202, kPositionNmea = 206, kMaxNmea = 128;

std::uint8_t checksum_of(std::string_view body) {
  std::uint8_t sum = 0;
  for (const char c : body) sum = static_cast<std::uint8_t>(sum ^ static_cast<std::uint8_t>(c));
  return sum;
}

/// The whole field as a number.
bool number(std::string_view field, double& value) {
  const auto r = std::from_chars(field.data(), field.data() + field.size(), value);
  return r.ec == std::errc{} && r.ptr == field.data() + field.size() && std::isfinite(value);
}

bool two_digits(std::string_view field, std::size_t at, int& value) {
  if (field.size() < at + 2) return false;
  const char a = field[at], b = field[at + 1];
  if (a < '0' || a > '9' || b < '0' || b > '9') return false;
  value = (a - '0') * 10 + (b - '0');
  return true;
}

/// "ddmm.mmmm" and its hemisphere.
bool angle(std::string_view field, std::string_view half, double limit_deg, double& value_deg) {
  double v = 0;
  if (!number(field, v) || v < 0 || half.size() != 1) return false;
  const double whole = std::floor(v / 100), minutes = v - whole * 100;
  if (minutes >= 60) return false;
  value_deg = whole + minutes / 60;
  if (value_deg > limit_deg) return false;
  if (half[0] == 'S' || half[0] == 'W')
    value_deg = -value_deg;
  else if (half[0] != 'N' && half[0] != 'E')
    return false;
  return true;
}

}  // namespace

std::string_view name_of(ReturnMode mode) {
  switch (mode) {
    case ReturnMode::strongest:
      return "strongest";
    case ReturnMode::last:
      return "last";
    case ReturnMode::dual:
      return "dual";
  }
  return "unknown";
}

std::string_view text_of(PacketFault fault) {
  switch (fault) {
    case PacketFault::none:
      return "nothing";
    case PacketFault::size:
      return "not 1206 bytes";
    case PacketFault::block_flag:
      return "a block without its flag FF EE";
    case PacketFault::azimuth:
      return "an azimuth above 360 degrees";
    case PacketFault::timestamp:
      return "a time beyond the hour";
    case PacketFault::return_mode:
      return "a return mode that is not strongest, last or dual";
  }
  return "unknown";
}

std::string_view name_of(PpsStatus status) {
  switch (status) {
    case PpsStatus::absent:
      return "absent";
    case PpsStatus::synchronizing:
      return "synchronizing";
    case PpsStatus::locked:
      return "locked";
    case PpsStatus::error:
      return "error";
  }
  return "unknown";
}

std::optional<DataPacket> DataPacket::parse(Bytes bytes, PacketFault& fault) noexcept {
  fault = PacketFault::size;
  if (bytes.size() != kDataBytes) return {};
  for (std::size_t b = 0; b < kBlocks; ++b) {
    fault = PacketFault::block_flag;
    if (bytes[b * kBlockBytes] != 0xFF || bytes[b * kBlockBytes + 1] != 0xEE) return {};
    fault = PacketFault::azimuth;
    if (load_le<std::uint16_t>(bytes, b * kBlockBytes + 2) > kTurn_cdeg) return {};
  }
  fault = PacketFault::timestamp;
  // A device that is waiting for its PPS pulse runs on for some seconds past the hour.
  if (load_le<std::uint32_t>(bytes, 1200) >= kHour_us + 10'000'000U) return {};
  fault = PacketFault::return_mode;
  if (bytes[1204] < 0x37 || bytes[1204] > 0x39) return {};
  fault = PacketFault::none;
  return DataPacket(bytes);
}

std::uint32_t DataPacket::azimuth_cdeg(std::size_t block) const noexcept {
  return load_le<std::uint16_t>(bytes_, block * kBlockBytes + 2) % kTurn_cdeg;
}
bool DataPacket::says_full_turn() const noexcept {
  for (std::size_t b = 0; b < kBlocks; ++b)
    if (load_le<std::uint16_t>(bytes_, b * kBlockBytes + 2) == kTurn_cdeg) return true;
  return false;
}
DataPacket::Return DataPacket::at(std::size_t block, std::size_t channel) const noexcept {
  const std::size_t at = block * kBlockBytes + 4 + channel * 3;
  return {load_le<std::uint16_t>(bytes_, at), bytes_[at + 2]};
}
std::uint32_t DataPacket::timestamp_us() const noexcept { return load_le<std::uint32_t>(bytes_, 1200); }

DataPacketWriter::DataPacketWriter() {
  for (std::size_t b = 0; b < kBlocks; ++b) {
    bytes_[b * kBlockBytes] = 0xFF;
    bytes_[b * kBlockBytes + 1] = 0xEE;
  }
}
void DataPacketWriter::set_azimuth(std::size_t block, std::uint32_t azimuth_cdeg) {
  store_le(bytes_, block * kBlockBytes + 2, static_cast<std::uint16_t>(azimuth_cdeg % kTurn_cdeg));
}
void DataPacketWriter::set(std::size_t block, std::size_t channel, DataPacket::Return r) {
  const std::size_t at = block * kBlockBytes + 4 + channel * 3;
  store_le(bytes_, at, r.range_raw);
  bytes_[at + 2] = r.intensity;
}
void DataPacketWriter::finish(std::uint32_t timestamp_us, ReturnMode mode, std::uint8_t product) {
  store_le(bytes_, 1200, timestamp_us);
  bytes_[1204] = static_cast<std::uint8_t>(mode);
  bytes_[1205] = product;
}

std::uint16_t range_raw_of(double range_m) {
  const double raw = std::round(range_m / kRangeUnit_m);
  return raw >= 1 && raw <= 65535 ? static_cast<std::uint16_t>(raw) : std::uint16_t{0};
}

std::optional<NmeaRmc> parse_rmc(std::string_view s) noexcept {
  while (!s.empty() && (s.back() == '\r' || s.back() == '\n')) s.remove_suffix(1);
  if (s.size() < 10 || s[0] != '$' || s.substr(3, 4) != "RMC,") return {};
  const std::size_t star = s.find('*');
  if (star == std::string_view::npos || s.size() != star + 3) return {};
  unsigned told = 0;
  const auto r = std::from_chars(s.data() + star + 1, s.data() + s.size(), told, 16);
  if (r.ec != std::errc{} || r.ptr != s.data() + s.size() || told != checksum_of(s.substr(1, star - 1)))
    return {};
  std::array<std::string_view, 10> field{};
  std::size_t count = 0;
  for (std::string_view rest = s.substr(0, star); count < field.size();) {
    const std::size_t comma = rest.find(',');
    field[count++] = rest.substr(0, comma);
    if (comma == std::string_view::npos) break;
    rest.remove_prefix(comma + 1);
  }
  if (count < field.size()) return {};
  NmeaRmc rmc;
  rmc.valid = field[2] == "A";
  if (!two_digits(field[1], 0, rmc.hour) || !two_digits(field[1], 2, rmc.minute) ||
      !number(field[1].substr(4), rmc.second) || rmc.hour > 23 || rmc.minute > 59 || rmc.second < 0 ||
      rmc.second >= 61)
    return {};
  if (!two_digits(field[9], 0, rmc.day) || !two_digits(field[9], 2, rmc.month) ||
      !two_digits(field[9], 4, rmc.year) || rmc.month < 1 || rmc.month > 12 || rmc.day < 1 || rmc.day > 31)
    return {};
  rmc.year += rmc.year < 80 ? 2000 : 1900;
  // A receiver without a fix leaves them empty.
  if (!field[3].empty() && !angle(field[3], field[4], 90, rmc.latitude_deg)) return {};
  if (!field[5].empty() && !angle(field[5], field[6], 180, rmc.longitude_deg)) return {};
  double knots = 0;
  if (!field[7].empty() && !number(field[7], knots)) return {};
  if (!field[8].empty() && !number(field[8], rmc.course_deg)) return {};
  rmc.speed_mps = knots * 0.514444;
  return rmc;
}

std::string compose_rmc(const NmeaRmc& m) {
  const auto split = [](double deg, int& whole, double& minutes) {
    // Rounded first, so that no 60.0000 minutes appear.
    const double ten_thousandths = std::round(std::abs(deg) * 600'000);
    whole = static_cast<int>(ten_thousandths / 600'000);
    minutes = (ten_thousandths - whole * 600'000.0) / 10'000;
  };
  int lat = 0, lon = 0;
  double lat_min = 0, lon_min = 0;
  split(m.latitude_deg, lat, lat_min);
  split(m.longitude_deg, lon, lon_min);
  char body[160];
  std::snprintf(body, sizeof body,
                "GPRMC,%02d%02d%02.0f,%c,%02d%07.4f,%c,%03d%07.4f,%c,%05.1f,%05.1f,%02d%02d%02d,000.0,E",
                m.hour, m.minute, std::floor(m.second), m.valid ? 'A' : 'V', lat, lat_min,
                m.latitude_deg < 0 ? 'S' : 'N', lon, lon_min, m.longitude_deg < 0 ? 'W' : 'E',
                m.speed_mps / 0.514444, m.course_deg, m.day, m.month, m.year % 100);
  char whole[176];
  std::snprintf(whole, sizeof whole, "$%s*%02X", body, checksum_of(body));
  return whole;
}

std::optional<PositionPacket> parse_position(Bytes bytes) noexcept {
  if (bytes.size() != kPositionBytes) return {};
  PositionPacket p;
  p.timestamp_us = load_le<std::uint32_t>(bytes, kPositionTime);
  if (p.timestamp_us >= kHour_us + 10'000'000U || bytes[kPositionPps] > 3) return {};
  p.pps = static_cast<PpsStatus>(bytes[kPositionPps]);
  const char* text = reinterpret_cast<const char*>(bytes.data()) + kPositionNmea;
  if (*text == '$') {
    std::size_t n = 0;
    while (n < kMaxNmea && text[n] != '\0' && text[n] != '\r' && text[n] != '\n') ++n;
    // A sentence is printable ASCII (NMEA 0183); it goes on to terminals and JSON.
    if (std::all_of(text, text + n, [](char c) { return c >= 0x20 && c < 0x7F; })) p.nmea = {text, n};
  }
  return p;
}

std::array<std::uint8_t, kPositionBytes> compose_position(const PositionPacket& p) {
  std::array<std::uint8_t, kPositionBytes> bytes{};
  store_le(bytes, kPositionTime, p.timestamp_us);
  bytes[kPositionPps] = static_cast<std::uint8_t>(p.pps);
  const std::size_t n = std::min(p.nmea.size(), kMaxNmea - 2);
  std::memcpy(bytes.data() + kPositionNmea, p.nmea.data(), n);
  if (n > 0) {
    bytes[kPositionNmea + n] = '\r';
    bytes[kPositionNmea + n + 1] = '\n';
  }
  return bytes;
}

DeviceTime HourClock::unwrap(std::uint32_t us) noexcept {
  if (started_) {
    const auto step = static_cast<std::int64_t>(us) - static_cast<std::int64_t>(last_us_);
    if (step < -static_cast<std::int64_t>(kHour_us / 2)) ++hours_;
    if (step > static_cast<std::int64_t>(kHour_us / 2)) --hours_;
  } else {
    hours_ = 0;
    started_ = true;
  }
  last_us_ = us;
  return DeviceTime((hours_ * static_cast<std::int64_t>(kHour_us) + static_cast<std::int64_t>(us)) * 1000);
}

}  // namespace rigor::velodyne
