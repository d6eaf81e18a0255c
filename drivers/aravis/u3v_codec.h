// USB3 Vision as bytes: the control protocol (GenCP over a bulk endpoint), events, and what stands before and
// behind each picture of the stream. Little-endian.
//
//   command      "U3VC" flags:16 command:16 length:16 request:16, then the command's own data
//   acknowledge  "U3VC" status:16 command:16 length:16 request:16, then its data
//   event        "U3VE" flags:16 0x0C00:16 length:16 request:16, 0:16 event:16 timestamp:64
//   leader       "U3VL" 0:16 size:16 block:64 0:16 type:16 timestamp:64 format:32 width:32 height:32 x:32
//   y:32
//                padding:16 0:16
//   trailer      "U3VT" 0:16 size:16 block:64 status:16 0:16 valid:64 height:32
//
// Decoding checks every length. No I/O; any thread.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "drivers/aravis/gvsp_codec.h"

namespace rigor::u3v {

using Bytes = std::span<const std::uint8_t>;
using gige::PixelFormat;
using gige::Region;

inline constexpr std::size_t kHeaderBytes = 12, kReadBytes = 12, kWriteHeadBytes = 8, kLeaderBytes = 52,
                             kTrailerBytes = 32, kEventBytes = 12;

/// GenCP's, and USB3 Vision's from 0xA000 on.
enum class Status : std::uint16_t {
  success = 0x0000,
  not_implemented = 0x8001,
  invalid_parameter = 0x8002,
  invalid_address = 0x8003,
  write_protect = 0x8004,
  access_denied = 0x8006,
  busy = 0x8007,
  invalid_header = 0x800E,
  stream_not_aligned = 0xA003,
  stream_inconsistent = 0xA004,
  data_discarded = 0xA100
};

enum class Command : std::uint16_t {
  read_memory = 0x0800,
  read_memory_ack = 0x0801,
  write_memory = 0x0802,
  write_memory_ack = 0x0803,
  pending_ack = 0x0805,
  event = 0x0C00
};

struct Request {
  std::uint16_t command = 0, request_id = 0;
  bool ack_wanted = true;
  std::uint64_t address = 0;
  std::uint16_t count = 0;  ///< of READMEM
  Bytes data;               ///< of WRITEMEM; a view of what was decoded
};
enum class Decoded : std::uint8_t { ok, not_u3v, bad_length, unknown_command };
/// Header fields are there unless not_u3v.
[[nodiscard]] Decoded decode_request(Bytes bytes, Request& request);
[[nodiscard]] std::vector<std::uint8_t> encode_read(std::uint16_t request_id, std::uint64_t address,
                                                    std::uint16_t count);
[[nodiscard]] std::vector<std::uint8_t> encode_write(std::uint16_t request_id, std::uint64_t address,
                                                     Bytes data);

struct Ack {
  Status status = Status::success;
  std::uint16_t command = 0, request_id = 0;
  std::vector<std::uint8_t> data;
};
[[nodiscard]] std::vector<std::uint8_t> encode_ack(const Ack& ack);
[[nodiscard]] std::optional<Ack> decode_ack(Bytes bytes);
/// The data of a WRITEMEM acknowledge (bytes that were written) and of PENDING_ACK (ms until the answer).
[[nodiscard]] std::vector<std::uint8_t> reserved_and(std::uint16_t value);

struct Event {
  std::uint16_t event_id = 0, request_id = 0;
  std::uint64_t timestamp_ns = 0;
};
inline constexpr std::uint16_t kTestEvent = 0x4FFF, kExposureStartEvent = 0x9001;
[[nodiscard]] std::vector<std::uint8_t> encode_event(const Event& event);
[[nodiscard]] std::optional<Event> decode_event(Bytes bytes);

struct Leader {
  std::uint64_t block_id = 0, timestamp_ns = 0;
  PixelFormat format = PixelFormat::mono8;
  Region region;
};
[[nodiscard]] std::vector<std::uint8_t> encode_leader(const Leader& leader);
[[nodiscard]] std::optional<Leader> decode_leader(Bytes bytes);

struct Trailer {
  std::uint64_t block_id = 0, valid_bytes = 0;
  Status status = Status::success;
  std::uint32_t height_px = 0;
};
[[nodiscard]] std::vector<std::uint8_t> encode_trailer(const Trailer& trailer);
[[nodiscard]] std::optional<Trailer> decode_trailer(Bytes bytes);

}  // namespace rigor::u3v
