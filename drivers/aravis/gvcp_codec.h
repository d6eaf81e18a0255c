// GVCP, the control protocol of GigE Vision, as bytes: one datagram is one command or one acknowledge.
//
//   command:      0x42  flags  command:16  length:16  request_id:16  payload[length]
//   acknowledge:  status:16    command:16  length:16  ack_id:16      payload[length]
//
// Both directions are here: a device decodes commands and encodes acknowledges, a client does the reverse.
// Decoding never reads past the datagram: every length, count and alignment is checked first, and a datagram
// that breaks the format decodes to a status instead of a command. Nothing here knows a socket, a register or
// a clock. Source: GigE Vision specification 1.2 (and the 2.0 additions named below), all fields big-endian.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <variant>
#include <vector>

#include "rt-core/byte_order.h"

namespace rigor::gige {

using Bytes = std::span<const std::uint8_t>;
using MutableBytes = std::span<std::uint8_t>;

inline constexpr std::uint16_t kGvcpPort = 3956;
inline constexpr std::size_t kGvcpHeaderSize = 8;
/// The longest payload: 576 (IP datagram that every host takes) - 20 IP - 8 UDP - 8 GVCP.
inline constexpr std::size_t kGvcpMaxPayload = 540;
inline constexpr std::size_t kGvcpMaxReadMemory = 536;
inline constexpr std::size_t kDiscoveryAckSize = 248;

enum class GvcpCommand : std::uint16_t {
  discovery_cmd = 0x0002,
  discovery_ack = 0x0003,
  force_ip_cmd = 0x0004,
  force_ip_ack = 0x0005,
  packet_resend_cmd = 0x0040,
  read_register_cmd = 0x0080,
  read_register_ack = 0x0081,
  write_register_cmd = 0x0082,
  write_register_ack = 0x0083,
  read_memory_cmd = 0x0084,
  read_memory_ack = 0x0085,
  write_memory_cmd = 0x0086,
  write_memory_ack = 0x0087,
  pending_ack = 0x0089,
  action_cmd = 0x0100,
  action_ack = 0x0101
};

/// Status of an acknowledge or of a stream packet, as it is on the wire.
enum class GvStatus : std::uint16_t {
  success = 0x0000,
  not_implemented = 0x8001,
  invalid_parameter = 0x8002,
  invalid_address = 0x8003,
  write_protect = 0x8004,
  bad_alignment = 0x8005,
  access_denied = 0x8006,
  busy = 0x8007,
  local_problem = 0x8008,
  packet_unavailable = 0x800C,
  invalid_header = 0x800E,
  no_reference_time = 0x8013,  ///< this and the next two of GigE Vision 2.0
  overflow = 0x8015,
  action_late = 0x8016,
  error = 0x8FFF
};
[[nodiscard]] const char* to_string(GvStatus s);

namespace gvcp_flag {
inline constexpr std::uint8_t kAckRequired = 0x01;
inline constexpr std::uint8_t kBroadcastAck = 0x10;  ///< discovery only
inline constexpr std::uint8_t kExtendedIds = 0x10;   ///< packet resend only (GigE Vision 2.0)
inline constexpr std::uint8_t kScheduled = 0x80;     ///< action only (GigE Vision 2.0)
}  // namespace gvcp_flag

/// At most `N` values without the heap.
template <class T, std::size_t N>
struct BoundedList {
  std::array<T, N> items{};
  std::size_t count = 0;
  [[nodiscard]] std::span<const T> view() const { return {items.data(), count}; }
};

struct DiscoveryCmd {};
struct ForceIpCmd {
  std::array<std::uint8_t, 6> mac{};
  std::uint32_t ip = 0, mask = 0, gateway = 0;
};
struct ReadRegisterCmd {
  BoundedList<std::uint32_t, kGvcpMaxPayload / 4> addresses;
};
struct RegisterWrite {
  std::uint32_t address = 0, value = 0;
};
struct WriteRegisterCmd {
  BoundedList<RegisterWrite, kGvcpMaxPayload / 8> writes;
};
struct ReadMemoryCmd {
  std::uint32_t address = 0;
  std::uint16_t count = 0;  ///< bytes
};
struct WriteMemoryCmd {
  std::uint32_t address = 0;
  Bytes data;  ///< into the datagram that was decoded
};
struct PacketResendCmd {
  std::uint16_t stream_channel = 0;
  std::uint64_t block_id = 0;
  std::uint32_t first_packet = 0, last_packet = 0;  ///< both inclusive
  bool extended_ids = false;
};
struct ActionCmd {
  std::uint32_t device_key = 0, group_key = 0, group_mask = 0;
  std::optional<std::uint64_t> time_ticks;  ///< of the device's timestamp; empty: at once
};
struct UnknownCmd {};

using GvcpCommandBody = std::variant<UnknownCmd, DiscoveryCmd, ForceIpCmd, ReadRegisterCmd, WriteRegisterCmd,
                                     ReadMemoryCmd, WriteMemoryCmd, PacketResendCmd, ActionCmd>;

/// A command as the device sees it.
struct GvcpRequest {
  std::uint16_t command = 0;  ///< the raw value: a client may send one that we do not know
  std::uint16_t request_id = 0;
  std::uint8_t flags = 0;
  GvcpCommandBody body;
  [[nodiscard]] bool ack_required() const { return (flags & gvcp_flag::kAckRequired) != 0; }
};

enum class DecodeStatus : std::uint8_t {
  ok,
  not_gvcp,     ///< shorter than a header, wrong key, request id 0 or a length that is not the datagram's: be
                ///< silent
  bad_payload,  ///< header fine, payload breaks its command's format: answer invalid_header
  bad_alignment  ///< an address or a count is not a multiple of 4
};

/// Decodes a command. On `bad_payload` and `bad_alignment` command, id and flags of `out` are set. Any
/// thread, no allocation; `out.body` may point into `datagram`.
[[nodiscard]] DecodeStatus decode_gvcp_request(Bytes datagram, GvcpRequest& out) noexcept;

/// What a device says of itself in discovery; strings are cut at their field's size, and decoded ones are
/// printable UTF-8 (device_text.h).
struct DiscoveryAck {
  std::uint16_t version_major = 0, version_minor = 0;
  std::uint32_t device_mode = 0;
  std::array<std::uint8_t, 6> mac{};
  std::uint32_t supported_ip_configuration = 0, current_ip_configuration = 0;
  std::uint32_t ip = 0, mask = 0, gateway = 0;
  std::string manufacturer, model, version, manufacturer_info, serial, user_name;
};

struct ReadRegisterAck {
  BoundedList<std::uint32_t, kGvcpMaxPayload / 4> values;
};
struct WriteRegisterAck {
  std::uint16_t index = 0;  ///< writes done; on an error the index of the one that failed
};
struct ReadMemoryAck {
  std::uint32_t address = 0;
  Bytes data;  ///< into the datagram that was decoded
};
struct WriteMemoryAck {
  std::uint16_t index = 0;
};
struct PendingAck {
  std::uint16_t time_to_completion_ms = 0;
};
struct EmptyAck {};
using GvcpAckBody = std::variant<EmptyAck, DiscoveryAck, ReadRegisterAck, WriteRegisterAck, ReadMemoryAck,
                                 WriteMemoryAck, PendingAck>;

/// An acknowledge as the client sees it. An error may come with an EmptyAck whatever the command.
struct GvcpAck {
  GvStatus status = GvStatus::success;
  std::uint16_t command = 0;
  std::uint16_t ack_id = 0;
  GvcpAckBody body;
};
/// Decodes an acknowledge. Any thread; allocates for discovery alone.
[[nodiscard]] DecodeStatus decode_gvcp_ack(Bytes datagram, GvcpAck& out);

// Encoders: each returns a whole datagram. Any thread; they allocate. Precondition for the lists and data:
// they fit kGvcpMaxPayload; what is beyond is an empty datagram.
using Datagram = std::vector<std::uint8_t>;
[[nodiscard]] Datagram encode_discovery_cmd(std::uint16_t id, bool allow_broadcast_ack = false);
[[nodiscard]] Datagram encode_read_register_cmd(std::uint16_t id, std::span<const std::uint32_t> addresses);
[[nodiscard]] Datagram encode_write_register_cmd(std::uint16_t id, std::span<const RegisterWrite> writes);
[[nodiscard]] Datagram encode_read_memory_cmd(std::uint16_t id, const ReadMemoryCmd& c);
[[nodiscard]] Datagram encode_write_memory_cmd(std::uint16_t id, std::uint32_t address, Bytes data);
[[nodiscard]] Datagram encode_packet_resend_cmd(std::uint16_t id, const PacketResendCmd& c);
[[nodiscard]] Datagram encode_action_cmd(std::uint16_t id, const ActionCmd& c);

/// An acknowledge with its payload as it is; the others are built on it.
[[nodiscard]] Datagram encode_ack(GvStatus status, std::uint16_t ack_command, std::uint16_t id,
                                  Bytes payload);
[[nodiscard]] Datagram encode_discovery_ack(std::uint16_t id, const DiscoveryAck& d);
[[nodiscard]] Datagram encode_read_register_ack(std::uint16_t id, std::span<const std::uint32_t> values);
[[nodiscard]] Datagram encode_write_ack(GvStatus status, GvcpCommand ack_command, std::uint16_t id,
                                        std::uint16_t index);
[[nodiscard]] Datagram encode_read_memory_ack(std::uint16_t id, std::uint32_t address, Bytes data);
[[nodiscard]] Datagram encode_pending_ack(std::uint16_t id, std::uint16_t time_to_completion_ms);

}  // namespace rigor::gige
