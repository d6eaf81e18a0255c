#include "drivers/v4l2/uvc_control.h"

#include <algorithm>
#include <cstring>

#include "rt-core/byte_order.h"

namespace rigor::v4l2::uvc {
namespace {

// UVC 1.1, A.8 request codes; A.9.1, A.9.8 selectors; 4.2.1.2 error codes.
constexpr std::uint8_t kSetCur = 0x01, kGetCur = 0x81, kGetMin = 0x82, kGetMax = 0x83, kGetRes = 0x84,
                       kGetLen = 0x85, kGetInfo = 0x86, kGetDef = 0x87;
constexpr std::uint8_t kProbe = 0x01, kCommit = 0x02, kErrorCode = 0x02;
constexpr std::uint8_t kNoError = 0x00, kNotReady = 0x01, kOutOfRange = 0x04, kInvalidUnit = 0x05,
                       kInvalidControl = 0x06, kInvalidRequest = 0x07;
constexpr std::uint8_t kDirectionIn = 0x80, kTypeMask = 0x60, kTypeClass = 0x20, kRecipientMask = 0x1F,
                       kRecipientInterface = 0x01;

Answer data_of(std::span<const std::uint8_t> bytes, std::uint32_t wanted) {
  Answer a;
  a.kind = Answer::Kind::data;
  a.length = std::min(
      {static_cast<std::uint32_t>(bytes.size()), wanted, static_cast<std::uint32_t>(a.bytes.size())});
  std::copy_n(bytes.begin(), a.length, a.bytes.begin());
  return a;
}
Answer byte_of(std::uint8_t value, std::uint32_t wanted) { return data_of(std::span(&value, 1), wanted); }

}  // namespace

std::array<std::uint8_t, kControlBytes11> encode(const StreamControl& c) noexcept {
  std::array<std::uint8_t, kControlBytes11> b{};
  store_le(b, 0, c.hint);
  b[2] = c.format_index, b[3] = c.frame_index;
  store_le(b, 4, c.interval);
  store_le(b, 18, c.max_frame_bytes);
  store_le(b, 22, c.max_payload_bytes);
  store_le(b, 26, 48'000'000U);  // dwClockFrequency
  b[30] = 3;                     // bmFramingInfo: frame id and end of frame are in the payload headers
  b[31] = 1, b[32] = 1, b[33] = 1;
  return b;
}

std::optional<StreamControl> decode(std::span<const std::uint8_t> b) noexcept {
  if (b.size() < kControlBytes10) return std::nullopt;
  StreamControl c;
  c.hint = load_le<std::uint16_t>(b);
  c.format_index = b[2], c.frame_index = b[3];
  c.interval = load_le<std::uint32_t>(b, 4);
  c.max_frame_bytes = load_le<std::uint32_t>(b, 18);
  c.max_payload_bytes = load_le<std::uint32_t>(b, 22);
  return c;
}

ControlPipe::ControlPipe(StreamOffer offer) : offer_(std::move(offer)) {
  if (offer_.formats.empty()) offer_.formats.push_back({});
  if (offer_.intervals.empty()) offer_.intervals.push_back(333'333);
  probed_ = committed_ =
      nearest({.hint = 0, .format_index = 1, .frame_index = 1, .interval = offer_.intervals.front()});
}

void ControlPipe::set_interfaces(std::uint8_t control, std::uint8_t streaming) noexcept {
  control_interface_ = control, streaming_interface_ = streaming;
}

StreamControl ControlPipe::nearest(const StreamControl& wanted) const noexcept {
  StreamControl c;
  c.hint = wanted.hint;
  const std::size_t format =
      std::clamp<std::size_t>(wanted.format_index, 1, std::min<std::size_t>(offer_.formats.size(), 255));
  c.format_index = static_cast<std::uint8_t>(format);
  c.frame_index = 1;
  c.interval = offer_.intervals.front();
  if (wanted.interval != 0)
    for (const std::uint32_t i : offer_.intervals) {
      const auto far = [&](std::uint32_t x) {
        return x > wanted.interval ? x - wanted.interval : wanted.interval - x;
      };
      if (far(i) < far(c.interval)) c.interval = i;
    }
  c.max_frame_bytes = offer_.formats[format - 1].frame_bytes;
  c.max_payload_bytes = offer_.payload_bytes;
  return c;
}

StreamControl ControlPipe::extreme(bool largest) const noexcept {
  StreamControl c;
  c.format_index = largest ? static_cast<std::uint8_t>(std::min<std::size_t>(offer_.formats.size(), 255)) : 1;
  const auto [least, most] = std::minmax_element(offer_.intervals.begin(), offer_.intervals.end());
  c.interval = largest ? *most : *least;
  c.max_frame_bytes = offer_.formats[c.format_index - 1U].frame_bytes;
  c.max_payload_bytes = offer_.payload_bytes;
  return c;
}

Answer ControlPipe::refuse(std::uint8_t code) noexcept {
  error_code_ = code;
  return {};
}

Answer ControlPipe::setup(const SetupPacket& p) noexcept {
  expected_ = 0;
  if ((p.request_type & kTypeMask) != kTypeClass || (p.request_type & kRecipientMask) != kRecipientInterface)
    return refuse(kInvalidRequest);
  const auto interface = static_cast<std::uint8_t>(p.index & 0xFF);
  const auto entity = static_cast<std::uint8_t>(p.index >> 8);
  const auto selector = static_cast<std::uint8_t>(p.value >> 8);
  const bool in = (p.request_type & kDirectionIn) != 0;
  // Requests that read have their high bit set; a direction that says otherwise is no UVC request.
  if (in != ((p.request & 0x80) != 0)) return refuse(kInvalidRequest);
  if (interface == streaming_interface_) return streaming(p);
  if (interface != control_interface_) return refuse(kInvalidUnit);
  if (entity == 0 && selector == kErrorCode && (p.request == kGetCur || p.request == kGetInfo)) {
    if (p.request == kGetInfo) return byte_of(0x01, p.length);  // GET is supported
    const std::uint8_t code = error_code_;
    error_code_ = kNoError;
    return byte_of(code, p.length);
  }
  return refuse(entity == 0 ? kInvalidControl : kInvalidUnit);
}

Answer ControlPipe::streaming(const SetupPacket& p) noexcept {
  const auto selector = static_cast<std::uint8_t>(p.value >> 8);
  if (selector != kProbe && selector != kCommit) return refuse(kInvalidControl);
  switch (p.request) {
    case kSetCur: {
      if (p.length < kControlBytes10 || p.length > Answer{}.bytes.size()) return refuse(kOutOfRange);
      expected_ = selector;
      Answer a;
      a.kind = Answer::Kind::expect;
      a.length = p.length;
      return a;
    }
    case kGetCur:
      return data_of(encode(selector == kProbe ? probed_ : committed_), p.length);
    case kGetMin:
      return data_of(encode(extreme(false)), p.length);
    case kGetMax:
      return data_of(encode(extreme(true)), p.length);
    case kGetDef:
      return data_of(encode(nearest({.hint = 0, .format_index = 1, .frame_index = 1, .interval = 0})),
                     p.length);
    case kGetRes:
      return data_of(std::array<std::uint8_t, kControlBytes11>{}, p.length);
    case kGetLen: {
      const std::array<std::uint8_t, 2> length{kControlBytes11, 0};
      return data_of(length, p.length);
    }
    case kGetInfo:
      return byte_of(0x03, p.length);  // GET and SET
    default:
      return refuse(kInvalidRequest);
  }
}

bool ControlPipe::data(std::span<const std::uint8_t> bytes) noexcept {
  const std::uint8_t selector = expected_;
  expected_ = 0;
  const auto wanted = decode(bytes);
  if (selector == 0 || !wanted) {
    error_code_ = selector == 0 ? kNotReady : kOutOfRange;
    return false;
  }
  const StreamControl control = nearest(*wanted);
  probed_ = control;
  if (selector == kCommit) committed_ = control;
  error_code_ = kNoError;
  return true;
}

}  // namespace rigor::v4l2::uvc
