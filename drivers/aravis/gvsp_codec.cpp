#include "drivers/aravis/gvsp_codec.h"

#include <algorithm>

namespace rigor::gige {
namespace {

constexpr std::uint8_t kExtendedIdBit = 0x80;

std::size_t put_header(GvStatus status, std::uint64_t block_id, std::uint32_t packet_id, GvspFormat format,
                       bool extended_ids, MutableBytes out) noexcept {
  store_be(out, 0, static_cast<std::uint16_t>(status));
  if (!extended_ids) {
    store_be(out, 2, static_cast<std::uint16_t>(block_id));
    store_be(out, 4, (static_cast<std::uint32_t>(format) << 24) | (packet_id & 0xFFFFFF));
    return kGvspHeaderSize;
  }
  store_be(out, 2, std::uint16_t{0});
  store_be(out, 4, (kExtendedIdBit | static_cast<std::uint32_t>(format)) << 24);
  store_be(out, 8, block_id);
  store_be(out, 16, packet_id);
  return kGvspExtendedHeaderSize;
}

}  // namespace

const char* to_string(PixelFormat f) {
  switch (f) {
    case PixelFormat::mono8:
      return "Mono8";
    case PixelFormat::mono10:
      return "Mono10";
    case PixelFormat::mono12:
      return "Mono12";
    case PixelFormat::mono12p:
      return "Mono12p";
    case PixelFormat::mono12_packed:
      return "Mono12Packed";
    case PixelFormat::mono16:
      return "Mono16";
    case PixelFormat::bayer_rg8:
      return "BayerRG8";
    case PixelFormat::bayer_rg10:
      return "BayerRG10";
    case PixelFormat::bayer_rg12:
      return "BayerRG12";
    case PixelFormat::bayer_rg16:
      return "BayerRG16";
    case PixelFormat::rgb8:
      return "RGB8";
  }
  return nullptr;
}

bool decode_gvsp(Bytes d, GvspPacket& out) noexcept {
  if (d.size() < kGvspHeaderSize) return false;
  out.status = static_cast<GvStatus>(load_be<std::uint16_t>(d, 0));
  out.extended_ids = (d[4] & kExtendedIdBit) != 0;
  out.payload = {};
  std::size_t at = kGvspHeaderSize;
  if (out.extended_ids) {
    if (d.size() < kGvspExtendedHeaderSize) return false;
    out.block_id = load_be<std::uint64_t>(d, 8);
    out.packet_id = load_be<std::uint32_t>(d, 16);
    at = kGvspExtendedHeaderSize;
  } else {
    out.block_id = load_be<std::uint16_t>(d, 2);
    out.packet_id = load_be<std::uint32_t>(d, 4) & 0xFFFFFF;
  }
  if (out.block_id == 0) return false;
  const std::uint8_t format = d[4] & 0x7F;
  if (format < 1 || format > 3) return false;
  out.format = static_cast<GvspFormat>(format);
  // 0x0100 marks a resent packet in GigE Vision 2.0; the data are as good as the first time.
  if ((static_cast<std::uint16_t>(out.status) & 0x8000) != 0) return true;

  const Bytes body = d.subspan(at);
  switch (out.format) {
    case GvspFormat::leader:
      if (body.size() < kGvspLeaderSize || out.packet_id != 0) return false;
      out.leader.payload_type = load_be<std::uint16_t>(body, 2);
      out.leader.timestamp_ticks = load_be<std::uint64_t>(body, 4);
      out.leader.format = static_cast<PixelFormat>(load_be<std::uint32_t>(body, 12));
      out.leader.region = {load_be<std::uint32_t>(body, 24), load_be<std::uint32_t>(body, 28),
                           load_be<std::uint32_t>(body, 16), load_be<std::uint32_t>(body, 20)};
      out.leader.padding_x = load_be<std::uint16_t>(body, 32);
      out.leader.padding_y = load_be<std::uint16_t>(body, 34);
      return (out.leader.payload_type & ~kChunkFlag) == kImagePayload;
    case GvspFormat::trailer:
      if (body.size() < kGvspTrailerSize) return false;
      out.trailer.payload_type = load_be<std::uint16_t>(body, 2);
      out.trailer.height_px = load_be<std::uint32_t>(body, 4);
      out.trailer.chunk_bytes = 0;
      if ((out.trailer.payload_type & kChunkFlag) != 0 && body.size() >= kGvspChunkTrailerSize)
        out.trailer.chunk_bytes = load_be<std::uint32_t>(body, 8);
      return out.packet_id != 0;
    default:
      out.payload = body;
      return out.packet_id != 0 && !body.empty();
  }
}

Bytes find_chunk(Bytes payload, std::uint32_t id) noexcept {
  constexpr std::size_t kTrailer = 8;  // id and length, behind the data
  while (payload.size() >= kTrailer) {
    const std::size_t end = payload.size() - kTrailer;
    const auto length = load_be<std::uint32_t>(payload, end + 4);
    if (length > end) return {};
    if (load_be<std::uint32_t>(payload, end) == id) return payload.subspan(end - length, length);
    payload = payload.first(end - length);
  }
  return {};
}

std::size_t GvspBlock::slice_size() const {
  return packet_size - kIpUdpHeaderSize - (extended_ids ? kGvspExtendedHeaderSize : kGvspHeaderSize);
}

std::uint32_t GvspBlock::packet_count() const {
  return static_cast<std::uint32_t>((data.size() + slice_size() - 1) / slice_size()) + 2;
}

std::size_t GvspBlock::encode_packet(std::uint32_t packet_id, MutableBytes out) const noexcept {
  const std::uint32_t count = packet_count();
  const std::size_t header = extended_ids ? kGvspExtendedHeaderSize : kGvspHeaderSize;
  if (packet_id >= count) return 0;
  if (packet_id == 0) {
    if (out.size() < header + kGvspLeaderSize) return 0;
    put_header(GvStatus::success, block_id, packet_id, GvspFormat::leader, extended_ids, out);
    const MutableBytes b = out.subspan(header);
    store_be(b, 0, std::uint16_t{0});
    store_be(b, 2, leader.payload_type);
    store_be(b, 4, leader.timestamp_ticks);
    store_be(b, 12, static_cast<std::uint32_t>(leader.format));
    store_be(b, 16, leader.region.width_px);
    store_be(b, 20, leader.region.height_px);
    store_be(b, 24, leader.region.x_px);
    store_be(b, 28, leader.region.y_px);
    store_be(b, 32, leader.padding_x);
    store_be(b, 34, leader.padding_y);
    return header + kGvspLeaderSize;
  }
  if (packet_id == count - 1) {
    const bool chunks = (leader.payload_type & kChunkFlag) != 0;
    const std::size_t size = chunks ? kGvspChunkTrailerSize : kGvspTrailerSize;
    if (out.size() < header + size) return 0;
    put_header(GvStatus::success, block_id, packet_id, GvspFormat::trailer, extended_ids, out);
    const MutableBytes b = out.subspan(header);
    store_be(b, 0, std::uint16_t{0});
    store_be(b, 2, leader.payload_type);
    store_be(b, 4, leader.region.height_px);
    if (chunks) {
      store_be(b, 8, static_cast<std::uint32_t>(data.size()));
      store_be(b, 12, std::uint32_t{0});  // layout: as the description says, always
    }
    return header + size;
  }
  const std::size_t from = std::size_t{packet_id - 1} * slice_size();
  const std::size_t length = std::min(slice_size(), data.size() - from);
  if (out.size() < header + length) return 0;
  put_header(GvStatus::success, block_id, packet_id, GvspFormat::payload, extended_ids, out);
  std::copy_n(data.begin() + static_cast<std::ptrdiff_t>(from), length,
              out.begin() + static_cast<std::ptrdiff_t>(header));
  return header + length;
}

std::size_t encode_gvsp_status(GvStatus status, std::uint64_t block_id, std::uint32_t packet_id,
                               GvspFormat format, bool extended_ids, MutableBytes out) noexcept {
  if (out.size() < (extended_ids ? kGvspExtendedHeaderSize : kGvspHeaderSize)) return 0;
  return put_header(status, block_id, packet_id, format, extended_ids, out);
}

}  // namespace rigor::gige
