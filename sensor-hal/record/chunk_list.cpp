#include "sensor-hal/record/chunk_list.h"

namespace rigor::record {

// Numbers go as seven bits a byte, the lowest first, each as its difference from what is nearest to it. A
// difference may be negative (sequences of log times may overlap from chunk to chunk): its sign is the lowest
// bit.

void ChunkList::put(std::uint64_t number) {
  for (; number >= 0x80; number >>= 7) packed_.push_back(static_cast<std::uint8_t>(number | 0x80));
  packed_.push_back(static_cast<std::uint8_t>(number));
}

void ChunkList::put_after(std::uint64_t before, std::uint64_t number) {
  const std::uint64_t difference = number - before;
  put((difference << 1) ^ (std::uint64_t{0} - (difference >> 63)));
}

void ChunkList::add(const ChunkPlace& chunk) {
  put_after(last_start_ns_, chunk.start_ns);
  put_after(chunk.start_ns, chunk.end_ns);
  put_after(last_end_, chunk.offset);
  put(chunk.length);
  put(chunk.index_length);
  put_after(chunk.length, chunk.compressed);
  put_after(chunk.compressed, chunk.uncompressed);
  put(chunk.index_offsets.size());
  std::uint64_t channel = 0, offset = chunk.offset + chunk.length;
  for (const auto& [c, o] : chunk.index_offsets) {
    put_after(channel, c);
    put_after(offset, o);
    channel = c;
    offset = o;
  }
  last_start_ns_ = chunk.start_ns;
  last_end_ = chunk.offset + chunk.length + chunk.index_length;
  ++size_;
}

std::uint64_t ChunkList::Cursor::number() {
  std::uint64_t number = 0;
  for (unsigned shift = 0;; shift += 7) {
    const std::uint8_t byte = list_->packed_[at_++];
    number |= std::uint64_t{byte & 0x7fu} << shift;
    if (byte < 0x80) return number;
  }
}

std::uint64_t ChunkList::Cursor::after(std::uint64_t before) {
  const std::uint64_t n = number();
  return before + ((n >> 1) ^ (std::uint64_t{0} - (n & 1)));
}

const ChunkPlace* ChunkList::Cursor::next() {
  if (at_ == list_->packed_.size()) return nullptr;
  ChunkPlace& p = place_;
  const std::uint64_t last_end = p.offset + p.length + p.index_length;
  p.start_ns = after(p.start_ns);
  p.end_ns = after(p.start_ns);
  p.offset = after(last_end);
  p.length = number();
  p.index_length = number();
  p.compressed = after(p.length);
  p.uncompressed = after(p.compressed);
  p.index_offsets.resize(number());
  std::uint64_t channel = 0, offset = p.offset + p.length;
  for (auto& [c, o] : p.index_offsets) {
    c = static_cast<std::uint16_t>(channel = after(channel));
    o = offset = after(offset);
  }
  return &p;
}

}  // namespace rigor::record
