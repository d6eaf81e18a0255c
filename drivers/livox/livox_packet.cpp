#include "drivers/livox/livox_packet.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "rt-core/byte_order.h"
#include "sensor-hal/record/crc32.h"

namespace rigor::livox {
namespace {

constexpr std::size_t kChecked = 28;  ///< where the timestamp begins
constexpr double kCentidegree = std::numbers::pi / 18000;

std::size_t point_bytes(DataType type) {
  switch (type) {
    case DataType::cartesian_mm:
      return 14;
    case DataType::cartesian_cm:
      return 8;
    case DataType::spherical:
      return 10;
    default:
      return 0;
  }
}

std::uint32_t checksum(Bytes packet) { return record::crc32(std::as_bytes(packet.subspan(kChecked))); }

std::vector<std::uint8_t>& begin(DataType type, const PacketHead& head, std::size_t dots, std::size_t data,
                                 std::vector<std::uint8_t>& out) {
  out.assign(kHeaderBytes + data, 0);
  store_le(out, 1, static_cast<std::uint16_t>(out.size()));
  store_le(out, 3, static_cast<std::uint16_t>(std::clamp<std::int64_t>(head.interval_ns / 100, 0, 65535)));
  store_le(out, 5, static_cast<std::uint16_t>(dots));
  store_le(out, 7, head.udp_count);
  out[9] = head.frame_count;
  out[10] = static_cast<std::uint8_t>(type);
  out[11] = static_cast<std::uint8_t>(head.time_type);
  store_le(out, 28, head.timestamp_ns);
  return out;
}

/// As a whole number of units, or none of it where it cannot be said.
template <class T>
bool whole(const Point& p, double units_per_m, std::array<T, 3>& to) {
  const double v[3] = {static_cast<double>(p.x_m), static_cast<double>(p.y_m), static_cast<double>(p.z_m)};
  for (std::size_t i = 0; i < 3; ++i) {
    const double scaled = std::round(v[i] * units_per_m);
    if (!(std::abs(scaled) <= static_cast<double>(std::numeric_limits<T>::max()))) return false;
    to[i] = static_cast<T>(scaled);
  }
  return true;
}

void store_point(DataType type, const Point& p, std::vector<std::uint8_t>& out, std::size_t at) {
  std::size_t end = at;
  bool said = false;
  if (type == DataType::cartesian_mm) {
    std::array<std::int32_t, 3> mm{};
    said = whole(p, 1e3, mm);
    for (std::size_t i = 0; said && i < 3; ++i) store_le(out, at + 4 * i, mm[i]);
    end = at + 12;
  } else if (type == DataType::cartesian_cm) {
    std::array<std::int16_t, 3> cm{};
    said = whole(p, 1e2, cm);
    for (std::size_t i = 0; said && i < 3; ++i) store_le(out, at + 2 * i, cm[i]);
    end = at + 6;
  } else {
    const double x = static_cast<double>(p.x_m), y = static_cast<double>(p.y_m),
                 z = static_cast<double>(p.z_m);
    const double range = std::sqrt(x * x + y * y + z * z);
    said = range > 0 && range < 4e6;
    if (said) {
      double azimuth = std::atan2(y, x);
      if (azimuth < 0) azimuth += 2 * std::numbers::pi;
      store_le(out, at, static_cast<std::uint32_t>(std::lround(range * 1e3)));
      store_le(out, at + 4, static_cast<std::uint16_t>(std::lround(std::acos(z / range) / kCentidegree)));
      store_le(out, at + 6, static_cast<std::uint16_t>(std::lround(azimuth / kCentidegree)));
    }
    end = at + 8;
  }
  if (!said) return;
  out[end] = p.reflectivity;
  out[end + 1] = p.tag;
}

}  // namespace

std::string_view name_of(DataType type) {
  switch (type) {
    case DataType::imu:
      return "imu";
    case DataType::cartesian_mm:
      return "cartesian_mm";
    case DataType::cartesian_cm:
      return "cartesian_cm";
    default:
      return "spherical";
  }
}

std::string_view name_of(TimeType type) {
  switch (type) {
    case TimeType::none:
      return "since it was switched on";
    case TimeType::ptp:
      return "PTP";
    default:
      return "GPS";
  }
}

std::string_view text_of(PacketFault fault) {
  switch (fault) {
    case PacketFault::none:
      return "good";
    case PacketFault::too_short:
      return "shorter than a header";
    case PacketFault::wrong_version:
      return "another version than 0";
    case PacketFault::wrong_length:
      return "another length than its own";
    case PacketFault::wrong_type:
      return "of no known type";
    case PacketFault::wrong_count:
      return "another number of points than its length";
    default:
      return "wrong checksum";
  }
}

std::optional<Packet> Packet::parse(Bytes b, PacketFault& fault) {
  const auto refuse = [&](PacketFault why) {
    fault = why;
    return std::optional<Packet>();
  };
  if (b.size() < kHeaderBytes) return refuse(PacketFault::too_short);
  if (b[0] != 0) return refuse(PacketFault::wrong_version);
  if (load_le<std::uint16_t>(b, 1) != b.size()) return refuse(PacketFault::wrong_length);
  if (b[10] > static_cast<std::uint8_t>(DataType::spherical) ||
      b[11] > static_cast<std::uint8_t>(TimeType::gps))
    return refuse(PacketFault::wrong_type);
  const auto type = static_cast<DataType>(b[10]);
  const std::uint32_t dots = load_le<std::uint16_t>(b, 5);
  const std::size_t data = b.size() - kHeaderBytes;
  if (type == DataType::imu ? b.size() != kImuBytes : dots == 0 || data != dots * point_bytes(type))
    return refuse(PacketFault::wrong_count);
  if (const auto told = load_le<std::uint32_t>(b, 24); told != 0 && told != checksum(b))
    return refuse(PacketFault::wrong_checksum);
  fault = PacketFault::none;
  return Packet(b, dots);
}

std::uint16_t Packet::udp_count() const { return load_le<std::uint16_t>(bytes_, 7); }
std::uint64_t Packet::timestamp_ns() const { return load_le<std::uint64_t>(bytes_, 28); }
std::int64_t Packet::interval_ns() const { return std::int64_t{load_le<std::uint16_t>(bytes_, 3)} * 100; }

Point Packet::point(std::uint32_t i) const {
  const DataType type = data_type();
  const std::size_t size = point_bytes(type), at = kHeaderBytes + i * size;
  Point p;
  p.reflectivity = bytes_[at + size - 2];
  p.tag = bytes_[at + size - 1];
  if (type == DataType::cartesian_mm) {
    const auto m = [&](std::size_t k) {
      return static_cast<float>(load_le<std::int32_t>(bytes_, at + 4 * k) * 1e-3);
    };
    p.x_m = m(0), p.y_m = m(1), p.z_m = m(2);
  } else if (type == DataType::cartesian_cm) {
    const auto m = [&](std::size_t k) {
      return static_cast<float>(load_le<std::int16_t>(bytes_, at + 2 * k) * 1e-2);
    };
    p.x_m = m(0), p.y_m = m(1), p.z_m = m(2);
  } else {
    const double range = load_le<std::uint32_t>(bytes_, at) * 1e-3;
    const double zenith = load_le<std::uint16_t>(bytes_, at + 4) * kCentidegree;
    const double azimuth = load_le<std::uint16_t>(bytes_, at + 6) * kCentidegree;
    p.x_m = static_cast<float>(range * std::sin(zenith) * std::cos(azimuth));
    p.y_m = static_cast<float>(range * std::sin(zenith) * std::sin(azimuth));
    p.z_m = static_cast<float>(range * std::cos(zenith));
  }
  return p;
}

ImuReading Packet::imu() const {
  ImuReading r;
  for (std::size_t i = 0; i < 3; ++i) {
    r.turn_rate_radps[i] = load_le<float>(bytes_, kHeaderBytes + 4 * i);
    r.acceleration_g[i] = load_le<float>(bytes_, kHeaderBytes + 12 + 4 * i);
  }
  return r;
}

void compose_points(DataType type, const PacketHead& head, std::span<const Point> points,
                    std::vector<std::uint8_t>& out) {
  const std::size_t size = point_bytes(type);
  begin(type, head, points.size(), points.size() * size, out);
  for (std::size_t i = 0; i < points.size(); ++i) store_point(type, points[i], out, kHeaderBytes + i * size);
  store_le(out, 24, checksum(out));
}

std::vector<std::uint8_t> compose_imu(const PacketHead& head, const ImuReading& r) {
  PacketHead h = head;
  h.interval_ns = 0;
  std::vector<std::uint8_t> out;
  begin(DataType::imu, h, 1, kImuBytes - kHeaderBytes, out);
  for (std::size_t i = 0; i < 3; ++i) {
    store_le(out, kHeaderBytes + 4 * i, r.turn_rate_radps[i]);
    store_le(out, kHeaderBytes + 12 + 4 * i, r.acceleration_g[i]);
  }
  store_le(out, 24, checksum(out));
  return out;
}

}  // namespace rigor::livox
