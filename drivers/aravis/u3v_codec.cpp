#include "drivers/aravis/u3v_codec.h"

#include "rt-core/byte_order.h"

namespace rigor::u3v {
namespace {

constexpr std::uint32_t kControlMagic = 0x43563355, kEventMagic = 0x45563355, kLeaderMagic = 0x4C563355,
                        kTrailerMagic = 0x54563355;
constexpr std::uint16_t kAckWanted = 0x4000, kImage = 0x0001;

std::vector<std::uint8_t> head(std::uint32_t magic, std::uint16_t first, std::uint16_t command,
                               std::size_t length, std::uint16_t request_id) {
  std::vector<std::uint8_t> out;
  out.reserve(kHeaderBytes + length);
  append_le(out, magic);
  append_le(out, first);
  append_le(out, command);
  append_le(out, static_cast<std::uint16_t>(length));
  append_le(out, request_id);
  return out;
}

/// Magic, reserved, size, block id.
std::vector<std::uint8_t> stream_head(std::uint32_t magic, std::size_t size, std::uint64_t block_id) {
  std::vector<std::uint8_t> out;
  out.reserve(size);
  append_le(out, magic);
  append_le(out, std::uint16_t{0});
  append_le(out, static_cast<std::uint16_t>(size));
  append_le(out, block_id);
  return out;
}

bool begins_with(Bytes b, std::uint32_t magic, std::size_t size) {
  return b.size() >= size && load_le<std::uint32_t>(b, 0) == magic;
}

}  // namespace

Decoded decode_request(Bytes b, Request& q) {
  if (!begins_with(b, kControlMagic, kHeaderBytes)) return Decoded::not_u3v;
  q.ack_wanted = (load_le<std::uint16_t>(b, 4) & kAckWanted) != 0;
  q.command = load_le<std::uint16_t>(b, 6);
  const std::size_t length = load_le<std::uint16_t>(b, 8);
  q.request_id = load_le<std::uint16_t>(b, 10);
  if (b.size() != kHeaderBytes + length) return Decoded::bad_length;
  switch (static_cast<Command>(q.command)) {
    case Command::read_memory:
      if (length != kReadBytes) return Decoded::bad_length;
      q.address = load_le<std::uint64_t>(b, kHeaderBytes);
      q.count = load_le<std::uint16_t>(b, kHeaderBytes + 10);
      return Decoded::ok;
    case Command::write_memory:
      if (length <= kWriteHeadBytes) return Decoded::bad_length;
      q.address = load_le<std::uint64_t>(b, kHeaderBytes);
      q.data = b.subspan(kHeaderBytes + kWriteHeadBytes);
      return Decoded::ok;
    default:
      return Decoded::unknown_command;
  }
}

std::vector<std::uint8_t> encode_read(std::uint16_t request_id, std::uint64_t address, std::uint16_t count) {
  auto out = head(kControlMagic, kAckWanted, static_cast<std::uint16_t>(Command::read_memory), kReadBytes,
                  request_id);
  append_le(out, address);
  append_le(out, std::uint16_t{0});
  append_le(out, count);
  return out;
}

std::vector<std::uint8_t> encode_write(std::uint16_t request_id, std::uint64_t address, Bytes data) {
  auto out = head(kControlMagic, kAckWanted, static_cast<std::uint16_t>(Command::write_memory),
                  kWriteHeadBytes + data.size(), request_id);
  append_le(out, address);
  out.insert(out.end(), data.begin(), data.end());
  return out;
}

std::vector<std::uint8_t> encode_ack(const Ack& ack) {
  auto out = head(kControlMagic, static_cast<std::uint16_t>(ack.status), ack.command, ack.data.size(),
                  ack.request_id);
  out.insert(out.end(), ack.data.begin(), ack.data.end());
  return out;
}

std::optional<Ack> decode_ack(Bytes b) {
  if (!begins_with(b, kControlMagic, kHeaderBytes)) return std::nullopt;
  if (b.size() != kHeaderBytes + load_le<std::uint16_t>(b, 8)) return std::nullopt;
  return Ack{static_cast<Status>(load_le<std::uint16_t>(b, 4)),
             load_le<std::uint16_t>(b, 6),
             load_le<std::uint16_t>(b, 10),
             {b.begin() + kHeaderBytes, b.end()}};
}

std::vector<std::uint8_t> reserved_and(std::uint16_t value) {
  std::vector<std::uint8_t> out;
  append_le(out, std::uint16_t{0});
  append_le(out, value);
  return out;
}

std::vector<std::uint8_t> encode_event(const Event& e) {
  auto out = head(kEventMagic, 0, static_cast<std::uint16_t>(Command::event), kEventBytes, e.request_id);
  append_le(out, std::uint16_t{0});
  append_le(out, e.event_id);
  append_le(out, e.timestamp_ns);
  return out;
}

std::optional<Event> decode_event(Bytes b) {
  if (!begins_with(b, kEventMagic, kHeaderBytes + kEventBytes)) return std::nullopt;
  return Event{load_le<std::uint16_t>(b, 14), load_le<std::uint16_t>(b, 10), load_le<std::uint64_t>(b, 16)};
}

std::vector<std::uint8_t> encode_leader(const Leader& l) {
  auto out = stream_head(kLeaderMagic, kLeaderBytes, l.block_id);
  append_le(out, std::uint16_t{0});
  append_le(out, kImage);
  append_le(out, l.timestamp_ns);
  for (const std::uint32_t v : {static_cast<std::uint32_t>(l.format), l.region.width_px, l.region.height_px,
                                l.region.x_px, l.region.y_px})
    append_le(out, v);
  append_le(out, std::uint32_t{0});  // no padding of rows, reserved
  return out;
}

std::optional<Leader> decode_leader(Bytes b) {
  if (!begins_with(b, kLeaderMagic, kLeaderBytes) || load_le<std::uint16_t>(b, 18) != kImage)
    return std::nullopt;
  const auto at = [&](std::size_t i) { return load_le<std::uint32_t>(b, i); };
  return Leader{load_le<std::uint64_t>(b, 8),
                load_le<std::uint64_t>(b, 20),
                static_cast<PixelFormat>(at(28)),
                {at(40), at(44), at(32), at(36)}};
}

std::vector<std::uint8_t> encode_trailer(const Trailer& t) {
  auto out = stream_head(kTrailerMagic, kTrailerBytes, t.block_id);
  append_le(out, static_cast<std::uint16_t>(t.status));
  append_le(out, std::uint16_t{0});
  append_le(out, t.valid_bytes);
  append_le(out, t.height_px);
  return out;
}

std::optional<Trailer> decode_trailer(Bytes b) {
  if (!begins_with(b, kTrailerMagic, kTrailerBytes)) return std::nullopt;
  return Trailer{load_le<std::uint64_t>(b, 8), load_le<std::uint64_t>(b, 20),
                 static_cast<Status>(load_le<std::uint16_t>(b, 16)), load_le<std::uint32_t>(b, 28)};
}

}  // namespace rigor::u3v
