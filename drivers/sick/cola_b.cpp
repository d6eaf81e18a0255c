#include "drivers/sick/cola_b.h"

#include <algorithm>
#include <cstring>

#include "rt-core/byte_order.h"

namespace rigor::sick {
namespace {

constexpr std::size_t kHeader = 8;
constexpr std::uint8_t kMark = 0x02;

std::uint8_t checksum(Bytes body) {
  std::uint8_t sum = 0;
  for (const auto b : body) sum ^= b;
  return sum;
}

}  // namespace

std::size_t begin_frame(Buffer& out) {
  const std::size_t begin = out.size();
  out.insert(out.end(), kHeader, kMark);
  return begin;
}

void end_frame(Buffer& out, std::size_t begin) {
  const auto size = static_cast<std::uint32_t>(out.size() - begin - kHeader);
  for (std::size_t i = 0; i < 4; ++i) out[begin + 4 + i] = static_cast<std::uint8_t>(size >> (8 * (3 - i)));
  out.push_back(checksum(Bytes(out).subspan(begin + kHeader)));
}

void append_frame(Bytes body, Buffer& out) {
  const auto begin = begin_frame(out);
  out.insert(out.end(), body.begin(), body.end());
  end_frame(out, begin);
}

void FrameParser::reset() { begin_ = end_ = 0; }

void FrameParser::compact() {
  if (begin_ == 0) return;
  std::memmove(data_.data(), data_.data() + begin_, end_ - begin_);
  end_ -= begin_;
  begin_ = 0;
}

std::span<std::uint8_t> FrameParser::room(std::size_t size) {
  if (begin_ == end_) begin_ = end_ = 0;
  if (data_.size() - end_ < size) {
    compact();
    if (data_.size() - end_ < size) data_.resize(end_ + size);
  }
  return std::span(data_).subspan(end_, size);
}

void FrameParser::added(std::size_t size) { end_ += std::min(size, data_.size() - end_); }

void FrameParser::add(Bytes piece) {
  if (piece.empty()) return;
  std::copy(piece.begin(), piece.end(), room(piece.size()).begin());
  added(piece.size());
}

Bytes FrameParser::next() {
  while (true) {
    const Bytes have = Bytes(data_).subspan(begin_, end_ - begin_);
    // The start mark: four times 02. Of a longer run the last four are it, for no length that anybody takes
    // begins with 02.
    std::size_t at = 0, run = 0;
    while (at < have.size() && run < 4) run = have[at++] == kMark ? run + 1 : 0;
    if (run < 4) {
      // The end may be the beginning of a mark.
      const std::size_t garbage = have.size() - run;
      skipped_ += garbage;
      begin_ += garbage;
      return {};
    }
    skipped_ += at - 4;
    begin_ += at - 4;
    const Bytes frame = Bytes(data_).subspan(begin_, end_ - begin_);
    if (frame.size() > 4 && frame[4] == kMark) {
      ++skipped_;
      ++begin_;
      continue;
    }
    if (frame.size() < kHeader) return {};
    const std::size_t size = load_be<std::uint32_t>(frame, 4);
    if (size == 0 || size > max_body_) {
      ++bad_lengths_;
      ++skipped_;
      ++begin_;
      continue;
    }
    if (frame.size() < size + kFrameOverhead) return {};
    const Bytes body = frame.subspan(kHeader, size);
    if (checksum(body) != frame[kHeader + size]) {
      ++bad_checksums_;
      ++skipped_;
      ++begin_;
      continue;
    }
    begin_ += size + kFrameOverhead;
    return body;
  }
}

}  // namespace rigor::sick
