// Commands between a host and a Livox Mid-360, as bytes: searching, parameters, what the device pushes.
//
//   24 bytes   0xAA, version 0, length (of all), seq_num, cmd_id, cmd_type (0 request, 1 answer),
//              sender_type (0 host, 1 LiDAR), 6 reserved, CRC-16 of these 18 bytes, CRC-32 of the data
//   data       parameters as key (u16), length (u16), value
//
// CRC-16/CCITT-FALSE, and the CRC-32 of Ethernet; that of no data is 0.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string_view>
#include <vector>

#include "drivers/livox/livox_packet.h"

namespace rigor::livox {

inline constexpr std::size_t kCommandHeaderBytes = 24, kMaxCommandBytes = 1400;

enum class CommandId : std::uint16_t {
  search = 0x0000,
  configure = 0x0100,
  inquire = 0x0101,
  push = 0x0102,
  reboot = 0x0200,
  factory_settings = 0x0201,
  set_gps_time = 0x0202
};

enum class Key : std::uint16_t {
  data_type = 0x0000,
  pattern_mode = 0x0001,
  lidar_ip = 0x0004,
  state_host = 0x0005,
  point_host = 0x0006,
  imu_host = 0x0007,
  install_attitude = 0x0012,
  fov_0 = 0x0015,
  fov_1 = 0x0016,
  fov_enable = 0x0017,
  detect_mode = 0x0018,
  io = 0x0019,
  target_mode = 0x001A,
  imu_enable = 0x001C,
  serial = 0x8000,
  product = 0x8001,
  firmware = 0x8002,
  loader = 0x8003,
  hardware = 0x8004,
  mac = 0x8005,
  state = 0x8006,
  temperature = 0x8007,
  power_ups = 0x8008,
  time_now = 0x8009,
  last_sync = 0x800A,
  time_offset = 0x800B,
  time_sync = 0x800C,
  diagnosis = 0x800E,
  firmware_type = 0x8010,
  hms_code = 0x8011
};

enum class WorkState : std::uint8_t {
  sampling = 1,
  idle = 2,
  error = 4,
  self_check = 5,
  motor_start = 6,
  upgrade = 8,
  ready = 9
};
[[nodiscard]] std::string_view name_of(WorkState state);

enum class ReturnCode : std::uint8_t {
  success = 0,
  failure = 1,
  not_now = 2,
  out_of_range = 3,
  not_supported = 0x20,
  reboot_needed = 0x21,
  read_only = 0x22,
  wrong_length = 0x23,
  wrong_count = 0x24
};
[[nodiscard]] std::string_view text_of(ReturnCode code);

/// Check value of "123456789": 0x29B1.
[[nodiscard]] std::uint16_t crc16(Bytes bytes);

struct Command {
  std::uint32_t sequence = 0;
  CommandId id = CommandId::search;
  bool answer = false, from_lidar = false;
  Bytes data;
};
/// Empty: not a command, cut short, or damaged. Any thread, no allocation.
[[nodiscard]] std::optional<Command> parse_command(Bytes datagram);
/// Precondition: at most kMaxCommandBytes in all.
[[nodiscard]] std::vector<std::uint8_t> compose_command(const Command& command);

struct Parameter {
  Key key{};
  Bytes value;
};
/// Parameters one after the other. Empty: fewer bytes than they say, or more than `count`.
[[nodiscard]] std::optional<std::vector<Parameter>> parse_parameters(Bytes list, std::size_t count);
void append_parameter(std::vector<std::uint8_t>& list, Key key, Bytes value);
/// Data of a request that sets parameters, or of a push: count, reserved, list.
[[nodiscard]] std::vector<std::uint8_t> parameter_data(std::span<const Parameter> parameters);

/// An address and two ports, as state_host, point_host and imu_host have them.
struct HostAddress {
  std::uint32_t ipv4 = 0;  ///< host order
  std::uint16_t port = 0, lidar_port = 0;
  bool operator==(const HostAddress&) const = default;
};
[[nodiscard]] std::array<std::uint8_t, 8> bytes_of(const HostAddress& host);
/// Precondition: 8 bytes.
[[nodiscard]] HostAddress host_of(Bytes value);

/// What a device answers to a search.
struct SearchAnswer {
  ReturnCode code = ReturnCode::success;
  std::uint8_t device_type = 0;
  std::string_view serial;  ///< up to 16 characters
  std::uint32_t ipv4 = 0;
  std::uint16_t command_port = 0;
};
inline constexpr std::uint8_t kMid360Type = 9;
[[nodiscard]] std::vector<std::uint8_t> search_data(const SearchAnswer& answer);
/// Empty: not that long. The serial number is a view of `data`.
[[nodiscard]] std::optional<SearchAnswer> parse_search(Bytes data);

}  // namespace rigor::livox
