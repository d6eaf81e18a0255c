#include "drivers/modbus/rtu_codec.h"

#include <algorithm>
#include <cstring>

#include "drivers/modbus/pdu.h"
#include "rt-core/byte_order.h"

namespace rigor::modbus {
namespace {

constexpr std::array<std::uint16_t, 256> make_table() {
  std::array<std::uint16_t, 256> table{};
  for (unsigned i = 0; i < 256; ++i) {
    unsigned c = i;
    for (int bit = 0; bit < 8; ++bit) c = (c & 1) != 0 ? c >> 1 ^ 0xA001 : c >> 1;
    table[i] = static_cast<std::uint16_t>(c);
  }
  return table;
}
constexpr auto kTable = make_table();

}  // namespace

std::uint16_t crc16(std::span<const std::uint8_t> bytes) noexcept {
  unsigned c = 0xFFFF;
  for (const auto b : bytes) c = c >> 8 ^ kTable[(c ^ b) & 0xFF];
  return static_cast<std::uint16_t>(c);
}

LineTimes LineTimes::of(unsigned baud, unsigned bits_per_character) noexcept {
  const auto character = Duration(static_cast<std::int64_t>(bits_per_character) * 1'000'000'000 / baud);
  return {character, baud > 19200 ? microseconds(1750) : Duration(character.ns() * 7 / 2)};
}

std::size_t seal_frame(std::span<std::uint8_t> frame, std::size_t size) noexcept {
  const auto crc = crc16(frame.first(size));
  store_le(frame, size, crc);
  return size + 2;
}

bool RtuFramer::add(std::span<const std::uint8_t> bytes, MonotonicTime now) noexcept {
  consume(taken_);
  if (bytes.empty()) return true;
  if (bytes.size() > data_.size() - size_) {
    size_ = 0;
    due_ = MonotonicTime::never();
    return false;
  }
  if (size_ == 0) since_ = now;
  std::memcpy(data_.data() + size_, bytes.data(), bytes.size());
  size_ += bytes.size();
  heard_ = now;
  due_ = now + gap_;
  return true;
}

void RtuFramer::consume(std::size_t n) noexcept {
  std::memmove(data_.data(), data_.data() + n, size_ - n);
  size_ -= n;
  taken_ = 0;
  if (size_ == 0) due_ = MonotonicTime::never();
}

bool RtuFramer::whole(std::size_t size) const noexcept {
  return size >= 4 && size <= size_ && size <= kMaxRtuFrame &&
         crc16({data_.data(), size - 2}) == load_le<std::uint16_t>(data_, size - 2);
}

RtuFramer::Found RtuFramer::next(MonotonicTime now, std::span<const std::uint8_t>& frame) noexcept {
  consume(taken_);
  if (size_ == 0) return Found::nothing;
  if (now < heard_ + gap_) return due_ = heard_ + gap_, Found::nothing;
  const std::size_t pdu = request_size({data_.data() + 1, size_ - 1});
  const std::size_t asked = pdu == 0 ? 0 : pdu + 3;
  // A request by its length; anything else on the line (an answer of another device) by the silence behind
  // it.
  std::size_t size = asked != 0 && whole(asked) ? asked : 0;
  if (size == 0 && (gap_.ns() > 0 || asked == 0) && whole(size_)) size = size_;
  if (size != 0) {
    frame = {data_.data(), size - 2};
    taken_ = size;
    due_ = now;
    return Found::frame;
  }
  const bool hopeless = size_ > kMaxRtuFrame || (gap_.ns() == 0 && asked != 0 && size_ >= asked);
  if (!hopeless && now < heard_ + timeout_) return due_ = heard_ + timeout_, Found::nothing;
  size_ = 0;
  due_ = MonotonicTime::never();
  return Found::garbage;
}

}  // namespace rigor::modbus
