#include "drivers/network/usbip_device.h"

#include <algorithm>

#include "rt-core/byte_order.h"

namespace rigor::usbip {
namespace {

// Requests of chapter 9 (USB 3.2, table 9-5), those of SuperSpeed included.
constexpr std::uint8_t kGetStatus = 0, kClearFeature = 1, kSetFeature = 3, kGetDescriptor = 6,
                       kGetConfiguration = 8, kSetConfiguration = 9, kGetInterface = 10, kSetInterface = 11,
                       kSetSel = 48, kSetIsochDelay = 49;
constexpr std::uint8_t kTypeMask = 0x60, kRecipientMask = 0x1F, kToInterface = 1, kToEndpoint = 2, kIn = 0x80;
constexpr std::uint16_t kEndpointHalt = 0;
constexpr std::uint8_t kEndpointDescriptor = 5;

}  // namespace

std::string string_descriptor(const std::string& text) {
  const std::size_t n = std::min<std::size_t>(text.size(), 126);
  std::string d{static_cast<char>(2 + 2 * n), static_cast<char>(kStringDescriptor)};
  for (std::size_t i = 0; i < n; ++i) append_le(d, std::uint16_t{static_cast<std::uint8_t>(text[i])});
  return d;
}

Device::Device(Descriptors descriptors) : descriptors_(std::move(descriptors)) {
  // Each descriptor begins with its length and its type.
  const auto& c = descriptors_.configuration;
  for (std::size_t i = 0; i + 2 < c.size() && c[i] != 0; i += c[i])
    if (c[i + 1] == kEndpointDescriptor) halted_[c[i + 2]] = false;
}

void Device::attach() {
  imported_ = true;
  configuration_ = 0;
  queues_.clear();
  for (auto& [endpoint, halted] : halted_) halted = false;
  on_attach();
}

void Device::detach() {
  imported_ = false;
  queues_.clear();
  on_detach();
}

std::size_t Device::waiting_messages(std::uint8_t endpoint) const {
  const auto at = queues_.find(endpoint);
  return at == queues_.end() ? 0 : at->second.size();
}

bool Device::get_descriptor(const SetupPacket& s, std::string& answer) const {
  const auto copy = [&](const std::vector<std::uint8_t>& d) {
    answer.append(d.begin(), d.end());
    return !d.empty();
  };
  const std::size_t index = s.value & 0xFF;
  switch (s.value >> 8) {
    case kDeviceDescriptor:
      return copy(descriptors_.device);
    case kConfigurationDescriptor:
      return index == 0 && copy(descriptors_.configuration);
    case kBosDescriptor:
      return copy(descriptors_.bos);
    case kStringDescriptor:
      if (index == 0) {
        answer.append({4, static_cast<char>(kStringDescriptor), 0x09, 0x04});  // English
        return true;
      }
      if (index > descriptors_.strings.size()) return false;
      answer += string_descriptor(descriptors_.strings[index - 1]);
      return true;
    default:
      return false;
  }
}

void Device::reset_endpoint(std::uint8_t endpoint, bool halt) {
  halted_[endpoint] = halt;
  queues_[endpoint].clear();
  on_reset(endpoint);
}

bool Device::control(const SetupPacket& s, Bytes, std::string& answer) {
  if ((s.request_type & kTypeMask) != 0) return false;  // of a class or a vendor
  const std::uint8_t recipient = s.request_type & kRecipientMask;
  const auto endpoint = static_cast<std::uint8_t>(s.index);
  if (recipient == kToEndpoint && s.request != kSetIsochDelay && (endpoint & 0x0F) != 0 &&
      !has_endpoint(endpoint))
    return false;
  if (recipient == kToInterface && (s.index & 0xFF) >= descriptors_.exported.interfaces.size()) return false;
  if ((s.request_type & kIn) != 0) {
    switch (s.request) {
      case kGetDescriptor:
        return get_descriptor(s, answer);
      case kGetStatus: {
        const bool halted = recipient == kToEndpoint && has_endpoint(endpoint) && halted_[endpoint];
        append_le(answer, std::uint16_t{halted ? std::uint16_t{1} : std::uint16_t{0}});
        return true;
      }
      case kGetConfiguration:
        answer += static_cast<char>(configuration_);
        return true;
      case kGetInterface:
        answer += '\0';  // there is one setting
        return true;
      default:
        return false;
    }
  }
  switch (s.request) {
    case kSetConfiguration:
      if (s.value > descriptors_.exported.configurations) return false;
      configuration_ = static_cast<std::uint8_t>(s.value);
      return true;
    case kSetInterface:
      return s.value == 0;
    case kClearFeature:
    case kSetFeature:
      if (recipient == kToEndpoint && s.value == kEndpointHalt && (endpoint & 0x0F) != 0)
        reset_endpoint(endpoint, s.request == kSetFeature);
      return true;  // link power states and remote wake-up change nothing here
    case kSetSel:
    case kSetIsochDelay:
      return true;
    default:
      return false;
  }
}

bool Device::write(std::uint8_t endpoint, Bytes data) {
  if (!has_endpoint(endpoint) || halted_[endpoint]) return false;
  return on_write(endpoint, data);
}

Device::Read Device::read(std::uint8_t endpoint, std::size_t length, std::string& out) {
  if (!has_endpoint(endpoint) || halted_[endpoint]) return Read::stall;
  auto& queue = queues_[endpoint];
  if (queue.empty()) return Read::wait;
  Queued& q = queue.front();
  const std::size_t n = std::min(length, q.end - q.at);
  out.append(reinterpret_cast<const char*>(q.bytes->data()) + q.at, n);
  q.at += n;
  if (q.at < q.end) return Read::data;
  const std::uint64_t tag = q.tag;
  queue.pop_front();
  on_sent(endpoint, tag);
  return Read::data;
}

}  // namespace rigor::usbip
