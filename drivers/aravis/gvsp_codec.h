// GVSP, the stream protocol of GigE Vision, as bytes: a frame is a block of packets.
//
//   packet 0          leader: pixel format, region, timestamp of the start of exposure in device ticks
//   packets 1 … n     payload: equal slices of the picture, the last one shorter
//   packet n+1        trailer: the number of lines
//
//   header: status:16  block_id:16  format:8  packet_id:24                             (standard ids, GigE
//   Vision 1.2)
//           status:16  flags:16  0x80|format:8  0:24  block_id:64  packet_id:32        (extended ids, 2.0)
//
// A multi-part frame (GigE Vision 2.1; always with extended ids) has several pictures, one after the other.
// Its leader has 48 bytes for each part and their number in the header's eighth byte; its payload packets
// begin with part:8 zone:8 offset:48, the offset counted from the start of the frame (as Aravis takes it),
// and no packet has bytes of two parts; its trailer has 16 bytes for each part.
//
// GvspBlock is a frame as the device keeps it: it makes any packet of itself on demand, so that a resend is
// one more call and not a copy. Decoding checks every length first. No sockets, no clock.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "drivers/aravis/gvcp_codec.h"

namespace rigor::gige {

/// PFNC values; bits 16…23 are the bits that a pixel takes.
enum class PixelFormat : std::uint32_t {
  mono8 = 0x01080001,
  mono12p = 0x010C0047,
  mono12_packed = 0x010C0006,
  mono10 = 0x01100003,
  mono12 = 0x01100005,
  mono16 = 0x01100007,
  bayer_rg8 = 0x01080009,
  bayer_rg10 = 0x0110000D,
  bayer_rg12 = 0x01100011,
  bayer_rg16 = 0x0110002F,
  rgb8 = 0x02180014,
  coord3d_c16 = 0x011000B8
};
[[nodiscard]] constexpr std::uint32_t bits_per_pixel(PixelFormat f) {
  return (static_cast<std::uint32_t>(f) >> 16) & 0xFF;
}
/// The PFNC name (`Mono8`), or nullptr for a value that is none of ours.
[[nodiscard]] const char* to_string(PixelFormat f);
[[nodiscard]] inline bool is_known(PixelFormat f) { return to_string(f) != nullptr; }

/// A rectangle of the sensor, in pixels.
struct Region {
  std::uint32_t x_px = 0, y_px = 0, width_px = 0, height_px = 0;
  bool operator==(const Region&) const = default;
};
[[nodiscard]] constexpr std::uint64_t payload_bytes(const Region& r, PixelFormat f) {
  return (std::uint64_t{r.width_px} * r.height_px * bits_per_pixel(f) + 7) / 8;
}

inline constexpr std::size_t kGvspHeaderSize = 8;
inline constexpr std::size_t kGvspExtendedHeaderSize = 20;
inline constexpr std::size_t kIpUdpHeaderSize = 28;  ///< counted in the packet size that a client asks for
inline constexpr std::size_t kGvspLeaderSize = 36;   ///< behind the header
inline constexpr std::size_t kGvspTrailerSize = 8, kGvspChunkTrailerSize = 16;
inline constexpr std::size_t kGvspMaxDatagram = 65507;

inline constexpr std::size_t kGvspPartInfoSize = 48, kGvspPartTrailerSize = 16, kGvspPartHeaderSize = 8;

enum class GvspFormat : std::uint8_t { leader = 1, trailer = 2, payload = 3, all_in = 4, multipart = 7 };

/// Types of payload. Pictures may have chunk data behind them (extended chunk mode of GigE Vision 2.0).
inline constexpr std::uint16_t kImagePayload = 0x0001, kMultipartPayload = 0x000A, kChunkFlag = 0x4000;

/// One picture of a multi-part frame.
struct GvspPart {
  std::uint16_t data_type = 0;  ///< kPart2d, kPart3d, kPartConfidence
  std::uint16_t purpose = 0;    ///< the SFNC's ComponentIDValue
  std::uint64_t length = 0;     ///< bytes
  PixelFormat format = PixelFormat::mono8;
  Region region;
};
inline constexpr std::size_t kMaxParts = 4;
inline constexpr std::uint16_t kPart2d = 1, kPart3d = 5, kPartConfidence = 9;
/// Components by their values in the SFNC.
inline constexpr std::uint16_t kIntensity = 1, kRange = 4, kConfidence = 6;

struct GvspLeader {
  std::uint16_t payload_type = 0;  ///< kImagePayload, with or without kChunkFlag
  std::uint64_t timestamp_ticks = 0;
  PixelFormat format = PixelFormat::mono8;
  Region region;
  std::uint16_t padding_x = 0, padding_y = 0;
  std::uint8_t part_count = 0;  ///< of a multi-part frame; format and region are then those of the first part
  std::array<GvspPart, kMaxParts> parts{};
};

struct GvspTrailer {
  std::uint16_t payload_type = 0;
  std::uint32_t height_px = 0;
  std::uint32_t chunk_bytes = 0;  ///< whole payload with its chunks, where it has some
};

/// One packet as the receiver sees it. `leader` and `trailer` hold for their own format with status success
/// alone.
struct GvspPacket {
  GvStatus status = GvStatus::success;
  GvspFormat format = GvspFormat::payload;
  bool extended_ids = false;
  std::uint64_t block_id = 0;
  std::uint32_t packet_id = 0;
  GvspLeader leader;
  GvspTrailer trailer;
  Bytes payload;          ///< into the datagram; of payload and multipart packets alone
  std::uint8_t part = 0;  ///< of multipart packets, as is the offset
  std::uint64_t part_offset = 0;
};

/// False where the datagram is no GVSP packet of a kind that we know. Any thread, no allocation.
[[nodiscard]] bool decode_gvsp(Bytes datagram, GvspPacket& out) noexcept;

/// The data of the chunk with this id in a payload that ends with chunks; empty where there is none, or where
/// the lengths make no sense. Any thread, no allocation.
[[nodiscard]] Bytes find_chunk(Bytes payload, std::uint32_t id) noexcept;

/// A frame ready to be sent, any packet of it in any order, any number of times.
class GvspBlock {
 public:
  std::uint64_t block_id = 0;
  GvspLeader leader;
  std::uint32_t packet_size = 1400;  ///< with IP and UDP headers, as SCPS says; at least 28 + 36 + header
  bool extended_ids = false;
  std::vector<std::uint8_t> data;

  /// Leader and trailer included.
  [[nodiscard]] std::uint32_t packet_count() const;
  /// Picture bytes in each payload packet but the last (of its part).
  [[nodiscard]] std::size_t slice_size() const;
  /// Writes packet `packet_id` and returns its length; 0 where the block has no such packet or `out` is too
  /// short. Any thread while the block is not changed; no allocation.
  [[nodiscard]] std::size_t encode_packet(std::uint32_t packet_id, MutableBytes out) const noexcept;

 private:
  [[nodiscard]] std::size_t encode_parts_leader(std::size_t header, MutableBytes out) const noexcept;
  [[nodiscard]] std::size_t encode_parts_trailer(std::uint32_t packet_id, std::size_t header,
                                                 MutableBytes out) const noexcept;
  [[nodiscard]] std::size_t encode_part_slice(std::uint32_t packet_id, std::size_t header,
                                              MutableBytes out) const noexcept;
};

/// Where packet `packet_id` (not the leader, not the trailer) of a frame with these parts lies.
struct PartSlice {
  std::uint8_t part = 0;
  std::uint64_t offset = 0;  ///< from the start of the frame
  std::size_t length = 0;    ///< 0: there is no such packet
};
[[nodiscard]] PartSlice find_slice(std::span<const std::uint64_t> part_bytes, std::size_t slice,
                                   std::uint32_t packet_id) noexcept;
/// Payload packets of a frame with these parts.
[[nodiscard]] std::uint32_t count_slices(std::span<const std::uint64_t> part_bytes,
                                         std::size_t slice) noexcept;

/// What answers a resend that cannot be served. Returns the length, 0 where `out` is too short.
[[nodiscard]] std::size_t encode_gvsp_status(GvStatus status, std::uint64_t block_id, std::uint32_t packet_id,
                                             GvspFormat format, bool extended_ids, MutableBytes out) noexcept;

}  // namespace rigor::gige
