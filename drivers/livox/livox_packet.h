// Packets of points and of the inertial unit of a Livox Mid-360, as bytes. Little-endian throughout; "Livox
// LiDAR Communication Protocol, Mid360", version 1.4.10.
//
//   36 bytes   version 0, length, time_interval (0.1 µs, from the first point to the last), dot_num, udp_cnt,
//              frame_cnt, data_type, time_type, 12 reserved, CRC-32 of what follows it, timestamp (ns)
//   data       dot_num points of 14, 8 or 10 bytes, or one reading of 24
//
// A point without a return is at range 0.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string_view>
#include <vector>

namespace rigor::livox {

using Bytes = std::span<const std::uint8_t>;

inline constexpr std::size_t kHeaderBytes = 36, kImuBytes = kHeaderBytes + 24, kMaxPacketBytes = 1400;
inline constexpr std::uint32_t kDots = 96;  ///< of a packet of points
inline constexpr std::uint32_t kLines = 4;
inline constexpr std::int64_t kPoint_ns = 5'000;  ///< from point to point
inline constexpr std::uint16_t kSearchPort = 56000, kCommandPort = 56100, kStatePort = 56200,
                               kPointPort = 56300, kImuPort = 56400;
inline constexpr std::uint16_t kHostCommandPort = 56101, kHostStatePort = 56201, kHostPointPort = 56301,
                               kHostImuPort = 56401;

enum class DataType : std::uint8_t { imu = 0, cartesian_mm = 1, cartesian_cm = 2, spherical = 3 };
[[nodiscard]] std::string_view name_of(DataType type);
/// What the timestamp counts: ns since the device was switched on, or of a clock that it was set by.
enum class TimeType : std::uint8_t { none = 0, ptp = 1, gps = 2 };
[[nodiscard]] std::string_view name_of(TimeType type);

enum class PacketFault : std::uint8_t {
  none,
  too_short,
  wrong_version,
  wrong_length,
  wrong_type,
  wrong_count,
  wrong_checksum
};
[[nodiscard]] std::string_view text_of(PacketFault fault);

struct Point {
  float x_m = 0, y_m = 0, z_m = 0;
  std::uint8_t reflectivity = 0;  ///< 0 to 150 matt, to 255 retro-reflecting
  std::uint8_t tag = 0;           ///< confidence, two bits each: glued, rain and dust, other; 0 is high
  [[nodiscard]] bool is_return() const { return x_m != 0 || y_m != 0 || z_m != 0; }
};
struct ImuReading {
  std::array<float, 3> turn_rate_radps{}, acceleration_g{};
};

/// A view of a packet that was checked.
class Packet {
 public:
  /// Empty: `fault` says why. A checksum of 0 is one that was not made. Any thread, no allocation.
  [[nodiscard]] static std::optional<Packet> parse(Bytes datagram, PacketFault& fault);

  [[nodiscard]] DataType data_type() const { return static_cast<DataType>(bytes_[10]); }
  [[nodiscard]] TimeType time_type() const { return static_cast<TimeType>(bytes_[11]); }
  [[nodiscard]] std::uint32_t dots() const { return dots_; }
  [[nodiscard]] std::uint16_t udp_count() const;
  [[nodiscard]] std::uint8_t frame_count() const { return bytes_[9]; }
  [[nodiscard]] std::uint64_t timestamp_ns() const;
  /// From the first point to the last.
  [[nodiscard]] std::int64_t interval_ns() const;
  /// Of point i after the first. Precondition: i < dots().
  [[nodiscard]] std::int64_t offset_ns(std::uint32_t i) const {
    return dots_ > 1 ? interval_ns() * i / (dots_ - 1) : 0;
  }
  /// Precondition: points, i < dots().
  [[nodiscard]] Point point(std::uint32_t i) const;
  /// Precondition: an IMU packet.
  [[nodiscard]] ImuReading imu() const;

 private:
  Packet(Bytes bytes, std::uint32_t dots) : bytes_(bytes), dots_(dots) {}
  Bytes bytes_;
  std::uint32_t dots_;
};

/// What a packet says of itself beside its data.
struct PacketHead {
  std::uint16_t udp_count = 0;
  std::uint8_t frame_count = 0;
  TimeType time_type = TimeType::none;
  std::uint64_t timestamp_ns = 0;
  std::int64_t interval_ns = kPoint_ns * (kDots - 1);
};
/// A packet of points; a coordinate that its type cannot say makes it one without a return. `out` is
/// replaced. Precondition: points of a packet of at most kMaxPacketBytes, a type of points.
void compose_points(DataType type, const PacketHead& head, std::span<const Point> points,
                    std::vector<std::uint8_t>& out);
[[nodiscard]] std::vector<std::uint8_t> compose_imu(const PacketHead& head, const ImuReading& reading);

}  // namespace rigor::livox
