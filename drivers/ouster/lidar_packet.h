// The datagrams of Ouster's sensors, byte by byte.
//
// Lidar, UDP 7502, little-endian: `columns_per_packet` columns (measurement blocks), each with the rows of
// one firing of all beams.
//
//   LEGACY   no packet header. Column: u64 timestamp [ns], u16 measurement id, u16 frame id, u32 encoder
//            count (90112 a turn), pixels, u32 status (all ones: good)
//   others   32 bytes of header: u16 packet type (1), u16 frame id, u24 initialization id, u40 serial number,
//            …; column: u64 timestamp, u16 measurement id, u16 status (bit 0: good), pixels; 32 bytes of
//            footer
//
//   profile                      bytes  first return                     second        near infrared
//   LEGACY                         12   20 bits of mm, u16 4, u16 6                    u16 8
//   RNG19_RFL8_SIG16_NIR16         12   19 bits of mm, u8 4, u16 6                     u16 8
//   RNG19_RFL8_SIG16_NIR16_DUAL    16   19 bits of mm, u8 3, u16 8       4, 7, 10      u16 12
//   RNG15_RFL8_NIR8                 4   15 bits of 8 mm, u8 2                          u8 3, sixteenths
//   (range, reflectivity, signal at these bytes of the pixel)
//
// A column is a whole row of beams at one encoder angle; measurement ids count columns of a turn from 0.
// A column outside of the azimuth window is there, and its status says that it is not good.
//
// IMU, UDP 7503, 48 bytes: u64 × 3 timestamps (system, accelerometer, gyroscope) [ns], float × 3 acceleration
// [g], float × 3 turn rate [deg/s].
//
// Sources: Ouster's Firmware User Manual (3.1, "Lidar Data"), ouster-sdk (parsing.cpp), and its digests of
// recordings (tests). Decoding: any thread, no allocation.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <string_view>
#include <vector>

#include "drivers/ouster/sensor_metadata.h"

namespace rigor::ouster {

using Bytes = std::span<const std::uint8_t>;

inline constexpr std::uint16_t kLidarPort = 7502, kImuPort = 7503;
inline constexpr std::size_t kImuBytes = 48;
inline constexpr std::uint32_t kEncoderTicks = 90112;

struct PacketLayout {
  Profile profile = Profile::legacy;
  std::uint32_t pixels = 0, columns = 0, columns_per_frame = 0;
  std::size_t header_bytes = 0, column_header_bytes = 0, pixel_bytes = 0, column_bytes = 0, packet_bytes = 0;

  [[nodiscard]] bool dual() const { return profile == Profile::dual; }
};
[[nodiscard]] PacketLayout layout_of(const Metadata& metadata);

/// One return of one beam.
struct Pixel {
  std::uint32_t range_mm = 0;  ///< from the lidar's origin; 0: none
  std::uint16_t signal = 0;    ///< photons; 0 where the profile has none
  std::uint8_t reflectivity = 0, flags = 0;
  bool operator==(const Pixel&) const = default;
};

/// What is wrong with a datagram on the lidar's port.
enum class PacketFault : std::uint8_t { none, size, type, frame, column };
[[nodiscard]] std::string_view text_of(PacketFault fault);

/// A checked lidar packet: a view on its bytes. The layout has to live as long.
class LidarPacket {
 public:
  class Column {
   public:
    [[nodiscard]] std::uint64_t timestamp_ns() const;
    [[nodiscard]] std::uint16_t measurement_id() const;
    [[nodiscard]] std::uint32_t status() const;
    [[nodiscard]] bool good() const;
    /// LEGACY; 0 elsewhere.
    [[nodiscard]] std::uint32_t encoder() const;
    /// `index` 1: of the profile with two returns. Precondition: row < pixels.
    [[nodiscard]] Pixel pixel(std::uint32_t row, std::uint32_t index = 0) const;
    [[nodiscard]] std::uint16_t near_infrared(std::uint32_t row) const;

   private:
    friend class LidarPacket;
    Column(const PacketLayout& layout, Bytes bytes) : layout_(&layout), bytes_(bytes) {}
    [[nodiscard]] std::size_t pixel_at(std::uint32_t row) const {
      return layout_->column_header_bytes + row * layout_->pixel_bytes;
    }
    const PacketLayout* layout_;
    Bytes bytes_;
  };

  /// Empty where anything is out of its bounds; `fault` then says what: another size, another type of packet,
  /// columns of two frames in one packet, a good column beyond the turn.
  [[nodiscard]] static std::optional<LidarPacket> parse(Bytes bytes, const PacketLayout& layout,
                                                        PacketFault& fault) noexcept;
  static std::optional<LidarPacket> parse(Bytes, PacketLayout&&, PacketFault&) = delete;  // it would be gone
  [[nodiscard]] std::uint32_t columns() const { return layout_->columns; }
  [[nodiscard]] Column column(std::uint32_t i) const;
  [[nodiscard]] std::uint16_t frame_id() const;
  /// 0 in LEGACY.
  [[nodiscard]] std::uint32_t initialization_id() const;

 private:
  LidarPacket(Bytes bytes, const PacketLayout& layout) : bytes_(bytes), layout_(&layout) {}
  Bytes bytes_;
  const PacketLayout* layout_;
};

/// A lidar packet that is being made; all pixels without a return at first.
class LidarPacketWriter {
 public:
  explicit LidarPacketWriter(const PacketLayout& layout);
  void set_header(std::uint16_t frame_id, std::uint32_t initialization_id, std::uint64_t serial);
  /// Clears the column's pixels.
  void set_column(std::uint32_t i, std::uint64_t timestamp_ns, std::uint16_t measurement_id, bool good);
  /// What does not fit into the profile's range is no return.
  void set_pixel(std::uint32_t i, std::uint32_t row, const Pixel& pixel, std::uint32_t index = 0);
  void set_near_infrared(std::uint32_t i, std::uint32_t row, std::uint16_t photons);
  [[nodiscard]] Bytes bytes() const { return bytes_; }

 private:
  [[nodiscard]] std::size_t column_at(std::uint32_t i) const {
    return layout_.header_bytes + i * layout_.column_bytes;
  }
  [[nodiscard]] std::span<std::uint8_t> pixel(std::uint32_t i, std::uint32_t row);
  PacketLayout layout_;
  std::uint16_t frame_id_ = 0;
  std::vector<std::uint8_t> bytes_;
};

struct ImuPacket {
  std::uint64_t system_ns = 0, accelerometer_ns = 0, gyroscope_ns = 0;
  std::array<float, 3> acceleration_g{}, turn_rate_dps{};
};
/// Empty: another size, or a number that is none.
[[nodiscard]] std::optional<ImuPacket> parse_imu(Bytes bytes) noexcept;
[[nodiscard]] std::array<std::uint8_t, kImuBytes> compose_imu(const ImuPacket& packet);

}  // namespace rigor::ouster
