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

Region load_region(Bytes b, std::size_t at) {
  return {load_be<std::uint32_t>(b, at + 8), load_be<std::uint32_t>(b, at + 12),
          load_be<std::uint32_t>(b, at), load_be<std::uint32_t>(b, at + 4)};
}

bool decode_parts(Bytes body, std::uint8_t count, GvspLeader& out) noexcept {
  if (count == 0 || count > kMaxParts || body.size() < 12 + count * kGvspPartInfoSize) return false;
  out.part_count = count;
  for (std::size_t i = 0; i < count; ++i) {
    const Bytes b = body.subspan(12 + i * kGvspPartInfoSize, kGvspPartInfoSize);
    GvspPart& p = out.parts[i];
    p.data_type = load_be<std::uint16_t>(b, 0);
    p.length = load_be<std::uint64_t>(b, 0) & 0xFFFF'FFFF'FFFF;
    p.format = static_cast<PixelFormat>(load_be<std::uint32_t>(b, 8));
    p.purpose = load_be<std::uint16_t>(b, 20);
    p.region = load_region(b, 24);
  }
  out.format = out.parts[0].format, out.region = out.parts[0].region;
  out.padding_x = out.padding_y = 0;
  return true;
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
    case PixelFormat::coord3d_c16:
      return "Coord3D_C16";
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
  if ((format < 1 || format > 3) && format != static_cast<std::uint8_t>(GvspFormat::multipart)) return false;
  out.format = static_cast<GvspFormat>(format);
  // 0x0100 marks a resent packet in GigE Vision 2.0; the data are as good as the first time.
  if ((static_cast<std::uint16_t>(out.status) & 0x8000) != 0) return true;

  const Bytes body = d.subspan(at);
  switch (out.format) {
    case GvspFormat::leader:
      if (body.size() < kGvspLeaderSize || out.packet_id != 0) return false;
      out.leader.payload_type = load_be<std::uint16_t>(body, 2);
      out.leader.timestamp_ticks = load_be<std::uint64_t>(body, 4);
      out.leader.part_count = 0;
      if (out.leader.payload_type == kMultipartPayload)
        return out.extended_ids && decode_parts(body, d[7], out.leader);
      out.leader.format = static_cast<PixelFormat>(load_be<std::uint32_t>(body, 12));
      out.leader.region = load_region(body, 16);
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
    case GvspFormat::multipart:
      if (body.size() <= kGvspPartHeaderSize || !out.extended_ids) return false;
      out.part = body[0];
      out.part_offset = load_be<std::uint64_t>(body, 0) & 0xFFFF'FFFF'FFFF;
      out.payload = body.subspan(kGvspPartHeaderSize);
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

PartSlice find_slice(std::span<const std::uint64_t> part_bytes, std::size_t slice,
                     std::uint32_t packet_id) noexcept {
  std::uint64_t before = packet_id - 1, begin = 0;
  for (std::size_t i = 0; i < part_bytes.size(); ++i) {
    const std::uint64_t packets = (part_bytes[i] + slice - 1) / slice;
    if (before < packets) {
      const std::uint64_t from = before * slice;
      return {static_cast<std::uint8_t>(i), begin + from,
              static_cast<std::size_t>(std::min<std::uint64_t>(slice, part_bytes[i] - from))};
    }
    before -= packets;
    begin += part_bytes[i];
  }
  return {};
}

std::uint32_t count_slices(std::span<const std::uint64_t> part_bytes, std::size_t slice) noexcept {
  std::uint64_t n = 0;
  for (const auto bytes : part_bytes) n += (bytes + slice - 1) / slice;
  return static_cast<std::uint32_t>(n);
}

std::size_t GvspBlock::slice_size() const {
  return packet_size - kIpUdpHeaderSize - (extended_ids ? kGvspExtendedHeaderSize : kGvspHeaderSize) -
         (leader.part_count > 0 ? kGvspPartHeaderSize : 0);
}

namespace {

/// Lengths of the parts of a frame.
std::span<const std::uint64_t> lengths_of(const GvspLeader& l, std::array<std::uint64_t, kMaxParts>& out) {
  for (std::size_t i = 0; i < l.part_count; ++i) out[i] = l.parts[i].length;
  return std::span(out).first(l.part_count);
}

}  // namespace

std::size_t GvspBlock::encode_parts_leader(std::size_t header, MutableBytes out) const noexcept {
  const std::size_t size = 12 + leader.part_count * kGvspPartInfoSize;
  if (out.size() < header + size) return 0;
  put_header(GvStatus::success, block_id, 0, GvspFormat::leader, extended_ids, out);
  out[7] = leader.part_count;
  const MutableBytes b = out.subspan(header, size);
  std::fill(b.begin(), b.end(), std::uint8_t{0});
  store_be(b, 2, leader.payload_type);
  store_be(b, 4, leader.timestamp_ticks);
  for (std::size_t i = 0; i < leader.part_count; ++i) {
    const GvspPart& p = leader.parts[i];
    const MutableBytes info = b.subspan(12 + i * kGvspPartInfoSize, kGvspPartInfoSize);
    store_be(info, 0, std::uint64_t{p.data_type} << 48 | p.length);
    store_be(info, 8, static_cast<std::uint32_t>(p.format));
    store_be(info, 20, p.purpose);
    store_be(info, 24, p.region.width_px);
    store_be(info, 28, p.region.height_px);
    store_be(info, 32, p.region.x_px);
    store_be(info, 36, p.region.y_px);
  }
  return header + size;
}

std::size_t GvspBlock::encode_parts_trailer(std::uint32_t packet_id, std::size_t header,
                                            MutableBytes out) const noexcept {
  const std::size_t size = 4 + leader.part_count * kGvspPartTrailerSize;
  if (out.size() < header + size) return 0;
  put_header(GvStatus::success, block_id, packet_id, GvspFormat::trailer, extended_ids, out);
  const MutableBytes b = out.subspan(header, size);
  std::fill(b.begin(), b.end(), std::uint8_t{0});
  store_be(b, 2, leader.payload_type);
  for (std::size_t i = 0; i < leader.part_count; ++i) {
    const GvspPart& p = leader.parts[i];
    const MutableBytes info = b.subspan(4 + i * kGvspPartTrailerSize, kGvspPartTrailerSize);
    store_be(info, 0, std::uint64_t{p.data_type} << 48 | p.length);
    store_be(info, 8, p.region.height_px);
  }
  return header + size;
}

std::size_t GvspBlock::encode_part_slice(std::uint32_t packet_id, std::size_t header,
                                         MutableBytes out) const noexcept {
  std::array<std::uint64_t, kMaxParts> lengths{};
  const auto at = find_slice(lengths_of(leader, lengths), slice_size(), packet_id);
  const std::size_t begin = header + kGvspPartHeaderSize;
  if (at.length == 0 || out.size() < begin + at.length || at.offset + at.length > data.size()) return 0;
  put_header(GvStatus::success, block_id, packet_id, GvspFormat::multipart, extended_ids, out);
  store_be(out, header, std::uint64_t{at.part} << 56 | at.offset);
  std::copy_n(data.begin() + static_cast<std::ptrdiff_t>(at.offset), at.length,
              out.begin() + static_cast<std::ptrdiff_t>(begin));
  return begin + at.length;
}

std::uint32_t GvspBlock::packet_count() const {
  if (leader.part_count > 0) {
    std::array<std::uint64_t, kMaxParts> lengths{};
    return count_slices(lengths_of(leader, lengths), slice_size()) + 2;
  }
  return static_cast<std::uint32_t>((data.size() + slice_size() - 1) / slice_size()) + 2;
}

std::size_t GvspBlock::encode_packet(std::uint32_t packet_id, MutableBytes out) const noexcept {
  const std::uint32_t count = packet_count();
  const std::size_t header = extended_ids ? kGvspExtendedHeaderSize : kGvspHeaderSize;
  if (packet_id >= count) return 0;
  if (leader.part_count > 0)
    return packet_id == 0           ? encode_parts_leader(header, out)
           : packet_id == count - 1 ? encode_parts_trailer(packet_id, header, out)
                                    : encode_part_slice(packet_id, header, out);
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
