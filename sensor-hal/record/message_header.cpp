#include "sensor-hal/record/message_header.h"

namespace rigor::record {

std::optional<msg::Header> read_header(Bytes message) {
  constexpr std::size_t kBegin = 4, kFixed = kBegin + 12;
  if (message.size() < kFixed || message[0] != std::byte{0}) return std::nullopt;
  const bool little = (message[1] & std::byte{1}) != std::byte{0};
  const auto u32 = [&](std::size_t at) {
    std::uint32_t v = 0;
    for (std::size_t i = 0; i < 4; ++i)
      v |= std::to_integer<std::uint32_t>(message[at + i]) << 8 * (little ? i : 3 - i);
    return v;
  };
  msg::Header header;
  header.stamp.sec = static_cast<std::int32_t>(u32(kBegin));
  header.stamp.nanosec = u32(kBegin + 4);
  const std::uint32_t length = u32(kBegin + 8);  // with the NUL
  if (header.stamp.nanosec >= 1'000'000'000 || length > message.size() - kFixed || length > 4096)
    return std::nullopt;
  if (length > 1) header.frame_id.assign(reinterpret_cast<const char*>(message.data() + kFixed), length - 1);
  return header;
}

}  // namespace rigor::record
