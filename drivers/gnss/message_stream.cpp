#include "drivers/gnss/message_stream.h"

#include <algorithm>

#include "rt-core/byte_order.h"

namespace rigor::gnss {
namespace {

constexpr std::uint8_t kUbx1 = 0xB5, kUbx2 = 0x62, kRtcm = 0xD3;

int hex_digit(std::uint8_t c) noexcept {
  if (c >= '0' && c <= '9') return c - '0';
  if (c >= 'A' && c <= 'F') return c - 'A' + 10;
  if (c >= 'a' && c <= 'f') return c - 'a' + 10;
  return -1;
}

}  // namespace

std::uint32_t crc24q(Bytes bytes) noexcept {
  std::uint32_t crc = 0;
  for (const std::uint8_t b : bytes) {
    crc ^= std::uint32_t{b} << 16;
    for (int i = 0; i < 8; ++i) crc = (crc & 0x800000) != 0 ? (crc << 1) ^ 0x1864CFB : crc << 1;
  }
  return crc & 0xFFFFFF;
}

void append_rtcm(Buffer& out, Bytes payload) {
  const std::size_t begin = out.size();
  out.push_back(kRtcm);
  out.push_back(static_cast<std::uint8_t>(payload.size() >> 8 & 3));
  out.push_back(static_cast<std::uint8_t>(payload.size()));
  out.insert(out.end(), payload.begin(), payload.end());
  const std::uint32_t crc = crc24q(Bytes(out).subspan(begin));
  for (const int shift : {16, 8, 0}) out.push_back(static_cast<std::uint8_t>(crc >> shift));
}

MessageStream::MessageStream() { data_.reserve(4 * (kMaxUbxPayload + kUbxOverhead)); }

void MessageStream::reset() noexcept {
  data_.clear();
  begin_ = 0;
  ended_ = false;
}

void MessageStream::add(Bytes bytes) {
  if (begin_ > 0) {
    data_.erase(data_.begin(), data_.begin() + static_cast<std::ptrdiff_t>(begin_));
    begin_ = 0;
  }
  data_.insert(data_.end(), bytes.begin(), bytes.end());
  counters_.bytes += bytes.size();
}

bool MessageStream::finish() noexcept {
  ended_ = true;
  return begin_ < data_.size();
}

MessageStream::Found MessageStream::look_ubx(Bytes at, Message& out) noexcept {
  if (at.size() < 2) return Found::incomplete;
  if (at[1] != kUbx2) return Found::nothing;
  if (at.size() < 6) return Found::incomplete;
  const std::size_t size = load_le<std::uint16_t>(at, 4);
  if (size > kMaxUbxPayload) {
    ++counters_.bad_lengths;
    return Found::nothing;
  }
  if (at.size() < size + kUbxOverhead) return Found::incomplete;
  const auto sum = ubx_checksum(at.subspan(2, size + 4));
  if (sum[0] != at[size + 6] || sum[1] != at[size + 7]) {
    ++counters_.bad_checksums;
    return Found::nothing;
  }
  ++counters_.ubx;
  out.kind = Message::Kind::ubx;
  out.ubx = ubx_id(at[2], at[3]);
  out.payload = at.subspan(6, size);
  out.frame = at.first(size + kUbxOverhead);
  return Found::message;
}

MessageStream::Found MessageStream::look_nmea(Bytes at, Message& out) noexcept {
  const std::size_t most = std::min(at.size(), kMaxSentence);
  std::size_t end = 1;
  while (end < most && at[end] >= 0x20 && at[end] < 0x7F && at[end] != '$') ++end;
  if (end == at.size() && end < kMaxSentence) return Found::incomplete;
  if (end == kMaxSentence || (at[end] != '\r' && at[end] != '\n')) return Found::nothing;
  // Its end of line: both characters where both are there; what is left of it is no garbage.
  std::size_t whole = end + 1;
  if (at[end] == '\r') {
    if (whole == at.size() && !ended_) return Found::incomplete;
    if (whole < at.size() && at[whole] == '\n') ++whole;
  }
  if (end < 6) return Found::nothing;
  bool good = at[end - 3] == '*';
  if (good) {
    std::uint8_t sum = 0;
    for (std::size_t i = 1; i < end - 3; ++i) sum ^= at[i];
    const int high = hex_digit(at[end - 2]), low = hex_digit(at[end - 1]);
    good = high >= 0 && low >= 0 && (high << 4 | low) == sum;
  }
  if (!good) {
    ++counters_.bad_checksums;
    return Found::nothing;
  }
  ++counters_.nmea;
  out.kind = Message::Kind::nmea;
  out.text = {reinterpret_cast<const char*>(at.data()) + 1, end - 4};
  out.frame = at.first(whole);
  return Found::message;
}

MessageStream::Found MessageStream::look_rtcm(Bytes at, Message& out) noexcept {
  if (at.size() < 3) return at.size() == 2 && (at[1] & 0xFC) != 0 ? Found::nothing : Found::incomplete;
  if ((at[1] & 0xFC) != 0) return Found::nothing;
  const std::size_t size = std::size_t{at[1]} << 8 | at[2];
  if (at.size() < size + 6) return Found::incomplete;
  const std::uint32_t crc =
      std::uint32_t{at[size + 3]} << 16 | std::uint32_t{at[size + 4]} << 8 | at[size + 5];
  // Its first byte is one that garbage has now and then: a mismatch says nothing of the line.
  if (crc24q(at.first(size + 3)) != crc) return Found::nothing;
  ++counters_.rtcm;
  out.kind = Message::Kind::rtcm;
  out.payload = at.subspan(3, size);
  out.frame = at.first(size + 6);
  return Found::message;
}

std::optional<Message> MessageStream::next() noexcept {
  while (begin_ < data_.size()) {
    const Bytes at = Bytes(data_).subspan(begin_);
    Message m;
    Found found = Found::nothing;
    if (at[0] == kUbx1)
      found = look_ubx(at, m);
    else if (at[0] == '$')
      found = look_nmea(at, m);
    else if (at[0] == kRtcm)
      found = look_rtcm(at, m);
    if (found == Found::message) {
      begin_ += m.frame.size();
      return m;
    }
    if (found == Found::incomplete && !ended_) return {};
    ++begin_;
    ++counters_.garbage;
  }
  return {};
}

}  // namespace rigor::gnss
