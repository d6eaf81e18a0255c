// The datagrams of Velodyne's VLP-16 and HDL-32E, byte by byte.
//
// Data, UDP 2368, 1206 bytes, little-endian: 12 blocks of { u16 0xEEFF, u16 azimuth in 0.01°, 32 × { u16
// range in 2 mm, u8 calibrated reflectivity } }, u32 µs since the top of the hour (of the first firing of the
// packet), u8 return mode (0x37 strongest, 0x38 last, 0x39 dual), u8 product (0x21 HDL-32E, 0x22 VLP-16).
// Range 0: no return. Dual: blocks 2i and 2i + 1 belong to the same firings; the first holds the last return,
// the second the strongest, or, where the last is the strongest, the second strongest. A firing with one
// return holds it in both.
//
// A VLP-16 puts two firing sequences of its 16 lasers into a block, an HDL-32E one of its 32.
//
// Position, UDP 8308, 512 bytes: u32 µs since the hour at 198, u8 PPS status at 202, an NMEA sentence
// ($GPRMC) at 206, ended by a line break or zeros.
//
// Sources: VLP-16 User Manual 63-9243 (chapter 9) and HDL-32E User Manual 63-9113; compared with ros-drivers/
// velodyne (rawdata.cpp), Kitware/VeloView (vtkDataPacket.h) and PCL (hdl_grabber.h).
//
// Decoding: any thread, no allocation.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>

#include "rt-core/time.h"

namespace rigor::velodyne {

using Bytes = std::span<const std::uint8_t>;

inline constexpr std::size_t kDataBytes = 1206, kPositionBytes = 512;
inline constexpr std::size_t kBlocks = 12, kChannels = 32, kMaxReturns = kBlocks * kChannels;
inline constexpr std::uint16_t kDataPort = 2368, kPositionPort = 8308;
inline constexpr std::uint32_t kTurn_cdeg = 36000;
inline constexpr double kRangeUnit_m = 0.002;
inline constexpr std::uint32_t kHour_us = 3'600'000'000U;

enum class ReturnMode : std::uint8_t { strongest = 0x37, last = 0x38, dual = 0x39 };
[[nodiscard]] std::string_view name_of(ReturnMode mode);

/// What is wrong with a datagram on the data port.
enum class PacketFault : std::uint8_t { none, size, block_flag, azimuth, timestamp, return_mode };
[[nodiscard]] std::string_view text_of(PacketFault fault);

/// A checked data packet: a view on its bytes.
class DataPacket {
 public:
  struct Return {
    std::uint16_t range_raw;
    std::uint8_t intensity;
  };
  /// Empty where anything is out of its bounds; `fault` then says what.
  [[nodiscard]] static std::optional<DataPacket> parse(Bytes bytes, PacketFault& fault) noexcept;

  /// 0 … 35999.
  [[nodiscard]] std::uint32_t azimuth_cdeg(std::size_t block) const noexcept;
  /// Whether a block says 36000 in place of 0, as devices do now and then.
  [[nodiscard]] bool says_full_turn() const noexcept;
  [[nodiscard]] Return at(std::size_t block, std::size_t channel) const noexcept;
  [[nodiscard]] std::uint32_t timestamp_us() const noexcept;
  [[nodiscard]] ReturnMode mode() const noexcept { return static_cast<ReturnMode>(bytes_[1204]); }
  [[nodiscard]] bool dual() const noexcept { return mode() == ReturnMode::dual; }
  [[nodiscard]] std::uint8_t product() const noexcept { return bytes_[1205]; }

 private:
  explicit DataPacket(Bytes bytes) : bytes_(bytes) {}
  Bytes bytes_;
};

/// A data packet that is being made; all ranges 0 at first.
class DataPacketWriter {
 public:
  DataPacketWriter();
  void set_azimuth(std::size_t block, std::uint32_t azimuth_cdeg);
  void set(std::size_t block, std::size_t channel, DataPacket::Return r);
  void finish(std::uint32_t timestamp_us, ReturnMode mode, std::uint8_t product);
  [[nodiscard]] Bytes bytes() const { return bytes_; }

 private:
  std::array<std::uint8_t, kDataBytes> bytes_{};
};

/// Range as the device counts it: rounded to 2 mm; 0 where there is none or it does not fit.
[[nodiscard]] std::uint16_t range_raw_of(double range_m);

enum class PpsStatus : std::uint8_t { absent = 0, synchronizing = 1, locked = 2, error = 3 };
[[nodiscard]] std::string_view name_of(PpsStatus status);

/// $GPRMC or $GNRMC (NMEA 0183): what a Velodyne hands on of its GPS receiver.
struct NmeaRmc {
  bool valid = false;  ///< status A
  int year = 0, month = 0, day = 0, hour = 0, minute = 0;
  double second = 0;
  double latitude_deg = 0, longitude_deg = 0;  ///< north and east positive
  double speed_mps = 0, course_deg = 0;
};
/// Empty: not an RMC sentence, a wrong checksum, or a field that is no number.
[[nodiscard]] std::optional<NmeaRmc> parse_rmc(std::string_view sentence) noexcept;
/// With checksum and without line break.
[[nodiscard]] std::string compose_rmc(const NmeaRmc& rmc);

struct PositionPacket {
  std::uint32_t timestamp_us = 0;
  PpsStatus pps = PpsStatus::absent;
  std::string_view nmea;  ///< into the bytes that were parsed; empty: none
};
/// Empty: another size, a time beyond the hour, a PPS status that there is not.
[[nodiscard]] std::optional<PositionPacket> parse_position(Bytes bytes) noexcept;
[[nodiscard]] std::array<std::uint8_t, kPositionBytes> compose_position(const PositionPacket& packet);

/// µs since the top of the hour, which start again at 0, as a clock that does not. One thread.
class HourClock {
 public:
  /// Nanoseconds since the hour of the first packet. Jumps by less than half an hour are taken as they are,
  /// also backwards (datagrams that overtook each other; a device that was set).
  [[nodiscard]] DeviceTime unwrap(std::uint32_t timestamp_us) noexcept;
  void reset() noexcept { started_ = false; }

 private:
  bool started_ = false;
  std::uint32_t last_us_ = 0;
  std::int64_t hours_ = 0;
};

}  // namespace rigor::velodyne
