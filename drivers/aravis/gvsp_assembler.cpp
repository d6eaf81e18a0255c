#include "drivers/aravis/gvsp_assembler.h"

#include <algorithm>
#include <utility>

namespace rigor::gige {

GvspAssembler::GvspAssembler(const GvspAssemblerOptions& options) : options_(options) {
  const std::size_t header = kIpUdpHeaderSize +
                             (options_.extended_ids ? kGvspExtendedHeaderSize : kGvspHeaderSize) +
                             (options_.part_bytes.empty() ? 0 : kGvspPartHeaderSize);
  slice_ = options_.packet_size > header ? options_.packet_size - header : 1;
}

std::uint64_t GvspAssembler::next_id(std::uint64_t id) const {
  return !options_.extended_ids && id == 0xFFFF ? 1 : id + 1;
}

std::int64_t GvspAssembler::distance(std::uint64_t a, std::uint64_t b) const {
  auto d = static_cast<std::int64_t>(a - b);
  if (options_.extended_ids) return d;
  constexpr std::int64_t kIds = 0xFFFF;  // 1 … 65535: 0 is no block
  if (d > kIds / 2) d -= kIds;
  if (d < -kIds / 2) d += kIds;
  return d;
}

GvspAssembler::Block* GvspAssembler::find_or_open(std::uint64_t id, DeviceTime now) {
  for (auto& b : blocks_) {
    if (b.frame.block_id == id) return b.given_up ? nullptr : &b;
  }
  // A block that was handed out already is closed: what trickles in for it must not open it again.
  if (last_taken_ != 0 && distance(id, last_taken_) <= 0 && distance(id, last_taken_) > -1000) {
    ++counters_.late;
    return nullptr;
  }
  if (blocks_.size() >= options_.max_blocks) {
    ++counters_.overflow;
    return nullptr;
  }
  Block b;
  if (!spare_.empty()) {
    b = std::move(spare_.back());
    spare_.pop_back();
  }
  b.frame.block_id = id;
  b.frame.leader = {};
  b.frame.complete = false;
  b.frame.missing.clear();
  b.frame.data.assign(options_.payload_bytes, 0);
  b.frame.t_first_packet = b.frame.t_last_packet = now;
  b.count = options_.part_bytes.empty()
                ? static_cast<std::uint32_t>((options_.payload_bytes + slice_ - 1) / slice_) + 2
                : count_slices(options_.part_bytes, slice_) + 2;
  b.received.assign(b.count, 0);
  b.ask_at.assign(b.count, DeviceTime::never());
  b.have = b.highest = b.asked = 0;
  b.refused = b.given_up = false;
  auto at = blocks_.end();
  while (at != blocks_.begin() && distance(std::prev(at)->frame.block_id, id) > 0) --at;
  return &*blocks_.insert(at, std::move(b));
}

void GvspAssembler::push(Bytes datagram, DeviceTime now) {
  GvspPacket p;
  if (!decode_gvsp(datagram, p) || p.extended_ids != options_.extended_ids) {
    ++counters_.malformed;
    return;
  }
  ++counters_.packets;
  Block* b = find_or_open(p.block_id, now);
  if (b == nullptr) return;
  b->frame.t_last_packet = now;
  if ((static_cast<std::uint16_t>(p.status) & 0x8000) != 0) {
    ++counters_.errors;
    b->refused = true;
    return;
  }
  accept(*b, p, now);
}

/// A picture alone has the whole payload; one with chunks leaves some of it to them.
bool GvspAssembler::has_expected_size(const GvspLeader& leader) const {
  if (leader.part_count != options_.part_bytes.size()) return false;
  for (std::size_t i = 0; i < leader.part_count; ++i)
    if (leader.parts[i].length != options_.part_bytes[i]) return false;
  if (leader.part_count > 0) return true;
  const std::uint64_t picture = payload_bytes(leader.region, leader.format);
  return (leader.payload_type & kChunkFlag) != 0 ? picture < options_.payload_bytes
                                                 : picture == options_.payload_bytes;
}

/// The bytes of a payload packet; false where they are not those that its number says.
bool GvspAssembler::take_slice(Block& b, const GvspPacket& p) const {
  if (p.packet_id == b.count - 1) return false;
  if (!options_.part_bytes.empty()) {
    const auto at = find_slice(options_.part_bytes, slice_, p.packet_id);
    if (p.format != GvspFormat::multipart || at.part != p.part || at.offset != p.part_offset ||
        at.length != p.payload.size() || at.offset + at.length > b.frame.data.size())
      return false;
    std::copy_n(p.payload.begin(), at.length, b.frame.data.begin() + static_cast<std::ptrdiff_t>(at.offset));
    return true;
  }
  const std::size_t from = std::size_t{p.packet_id - 1} * slice_;
  const std::size_t length = std::min(slice_, b.frame.data.size() - from);
  if (p.format != GvspFormat::payload || p.payload.size() < length || p.payload.size() > slice_) return false;
  std::copy_n(p.payload.begin(), length, b.frame.data.begin() + static_cast<std::ptrdiff_t>(from));
  return true;
}

void GvspAssembler::accept(Block& b, const GvspPacket& p, DeviceTime now) {
  if (p.packet_id >= b.count) {
    ++counters_.wrong_packet;
    return;
  }
  if (b.received[p.packet_id] != 0) {
    ++counters_.duplicates;
    return;
  }
  switch (p.format) {
    case GvspFormat::leader:
      // A block of another size than the one that was agreed on would be torn, not shown.
      if (!is_known(p.leader.format) || !has_expected_size(p.leader)) {
        ++counters_.wrong_packet;
        return;
      }
      b.frame.leader = p.leader;
      break;
    case GvspFormat::payload:
    case GvspFormat::multipart:
      if (!take_slice(b, p)) {
        ++counters_.wrong_packet;
        return;
      }
      break;
    default:
      if (p.packet_id != b.count - 1) {
        ++counters_.wrong_packet;
        return;
      }
  }
  b.received[p.packet_id] = 1;
  ++b.have;
  for (std::uint32_t i = b.highest; i < p.packet_id; ++i) {
    if (b.received[i] == 0 && b.ask_at[i] == DeviceTime::never())
      b.ask_at[i] = now + options_.first_resend_after;
  }
  b.highest = std::max(b.highest, p.packet_id);
}

std::vector<PacketResendCmd> GvspAssembler::resends(DeviceTime now) {
  std::vector<PacketResendCmd> out;
  for (auto& b : blocks_) {
    if (b.refused || b.given_up || b.have == b.count) continue;
    // The tail has nothing behind it that would show its loss: silence does.
    if (now - b.frame.t_last_packet >= options_.resend_again_after) {
      for (std::uint32_t i = 0; i < b.count; ++i) {
        if (b.received[i] == 0 && b.ask_at[i] == DeviceTime::never()) b.ask_at[i] = now;
      }
    }
    for (std::uint32_t i = 0; i < b.count; ++i) {
      if (b.received[i] != 0 || b.ask_at[i] > now) continue;
      PacketResendCmd c{0, b.frame.block_id, i, i, options_.extended_ids};
      while (c.last_packet + 1 < b.count && b.received[c.last_packet + 1] == 0 &&
             b.ask_at[c.last_packet + 1] <= now) {
        ++c.last_packet;
      }
      const std::uint32_t n = c.last_packet - c.first_packet + 1;
      if (b.asked + n > options_.max_resend_packets_per_block) break;
      b.asked += n;
      counters_.resends_asked += n;
      for (std::uint32_t k = c.first_packet; k <= c.last_packet; ++k)
        b.ask_at[k] = now + options_.resend_again_after;
      i = c.last_packet;
      out.push_back(c);
    }
  }
  return out;
}

void GvspAssembler::finish(Block& b) {
  b.frame.complete = b.have == b.count;
  ++(b.frame.complete ? counters_.frames_complete : counters_.frames_incomplete);
  for (std::uint32_t i = 0; i < b.count && !b.frame.complete; ++i) {
    if (b.received[i] != 0) continue;
    if (!b.frame.missing.empty() && b.frame.missing.back().last + 1 == i) {
      b.frame.missing.back().last = i;
    } else {
      b.frame.missing.push_back({i, i});
    }
  }
}

bool GvspAssembler::take(DeviceTime now, AssembledFrame& out) {
  if (blocks_.empty()) return false;
  Block& b = blocks_.front();
  const bool over = b.have == b.count || b.given_up || now - b.frame.t_last_packet >= options_.give_up_after;
  if (!over) return false;
  finish(b);
  if (last_taken_ != 0) {
    const auto gap = distance(b.frame.block_id, next_id(last_taken_));
    if (gap > 0) counters_.frames_lost += static_cast<std::uint64_t>(gap);
  }
  last_taken_ = b.frame.block_id;
  std::swap(out, b.frame);
  spare_.push_back(std::move(b));
  blocks_.pop_front();
  return true;
}

void GvspAssembler::flush() {
  for (auto& b : blocks_) b.given_up = b.have != b.count;
}

}  // namespace rigor::gige
