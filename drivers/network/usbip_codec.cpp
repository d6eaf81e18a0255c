#include "drivers/network/usbip_codec.h"

#include <algorithm>
#include <cstring>

#include "rt-core/byte_order.h"

namespace rigor::usbip {
namespace {

constexpr std::size_t kPathBytes = 256, kInterfaceBytes = 4;
/// What the kernel says for "not isochronous" in packets.
constexpr std::uint32_t kNoPackets = 0xFFFFFFFF;

void append_text(std::string& out, const std::string& text, std::size_t field) {
  const std::size_t at = out.size(), n = std::min(text.size(), field - 1);
  out.append(text, 0, n);
  out.resize(at + field, '\0');
}
std::string field_text(Bytes field) {
  const auto end = std::find(field.begin(), field.end(), std::uint8_t{0});
  return {field.begin(), end};
}

}  // namespace

Operation decode_operation(Bytes b) {
  return {load_be<std::uint16_t>(b, 0), load_be<std::uint16_t>(b, 2), load_be<std::uint32_t>(b, 4)};
}

void append_operation(std::string& out, const Operation& o) {
  append_be(out, o.version);
  append_be(out, o.code);
  append_be(out, o.status);
}

void append_bus_id(std::string& out, const std::string& bus_id) { append_text(out, bus_id, kBusIdBytes); }
std::string decode_bus_id(Bytes field) { return field_text(field); }

void append_device(std::string& out, const ExportedDevice& d, bool with_interfaces) {
  append_text(out, d.path, kPathBytes);
  append_bus_id(out, d.bus_id);
  append_be(out, d.bus);
  append_be(out, d.number);
  append_be(out, static_cast<std::uint32_t>(d.speed));
  for (const std::uint16_t v : {d.vendor, d.product, d.release}) append_be(out, v);
  for (const std::uint8_t v :
       {d.device_class.device_class, d.device_class.subclass, d.device_class.protocol, d.configuration,
        d.configurations, static_cast<std::uint8_t>(d.interfaces.size())})
    append_be(out, v);
  if (!with_interfaces) return;
  for (const InterfaceClass& i : d.interfaces)
    for (const std::uint8_t v : {i.device_class, i.subclass, i.protocol, std::uint8_t{0}}) append_be(out, v);
}

std::optional<ExportedDevice> decode_device(Bytes b, bool with_interfaces) {
  if (b.size() < kDeviceBytes) return std::nullopt;
  ExportedDevice d;
  d.path = field_text(b.first(kPathBytes));
  d.bus_id = field_text(b.subspan(kPathBytes, kBusIdBytes));
  b = b.subspan(kPathBytes + kBusIdBytes);
  d.bus = load_be<std::uint32_t>(b, 0), d.number = load_be<std::uint32_t>(b, 4);
  d.speed = static_cast<Speed>(load_be<std::uint32_t>(b, 8));
  d.vendor = load_be<std::uint16_t>(b, 12), d.product = load_be<std::uint16_t>(b, 14);
  d.release = load_be<std::uint16_t>(b, 16);
  d.device_class = {b[18], b[19], b[20]};
  d.configuration = b[21], d.configurations = b[22];
  d.interfaces.resize(b[23]);
  if (!with_interfaces) return d;
  b = b.subspan(24);
  if (b.size() < d.interfaces.size() * kInterfaceBytes) return std::nullopt;
  for (std::size_t i = 0; i < d.interfaces.size(); ++i)
    d.interfaces[i] = {b[i * kInterfaceBytes], b[i * kInterfaceBytes + 1], b[i * kInterfaceBytes + 2]};
  return d;
}

std::optional<Header> decode_header(Bytes b) {
  Header h;
  const auto command = load_be<std::uint32_t>(b, 0);
  if (command < 1 || command > 4) return std::nullopt;
  h.command = static_cast<Command>(command);
  h.sequence = load_be<std::uint32_t>(b, 4);
  h.device_id = load_be<std::uint32_t>(b, 8);
  h.in = load_be<std::uint32_t>(b, 12) == 1;
  h.endpoint = load_be<std::uint32_t>(b, 16);
  switch (h.command) {
    case Command::submit:
      h.length = load_be<std::uint32_t>(b, 24);
      h.start_frame = load_be<std::uint32_t>(b, 28);
      h.packets = load_be<std::uint32_t>(b, 32);
      std::copy_n(b.begin() + 40, h.setup.size(), h.setup.begin());
      break;
    case Command::submitted:
      h.status = load_be<std::int32_t>(b, 20);
      h.length = load_be<std::uint32_t>(b, 24);
      h.start_frame = load_be<std::uint32_t>(b, 28);
      h.packets = load_be<std::uint32_t>(b, 32);
      break;
    case Command::unlink:
      h.unlink = load_be<std::uint32_t>(b, 20);
      break;
    case Command::unlinked:
      h.status = load_be<std::int32_t>(b, 20);
      break;
  }
  if (h.packets == kNoPackets) h.packets = 0;
  return h;
}

void append_header(std::string& out, const Header& h) {
  const std::size_t at = out.size();
  append_be(out, static_cast<std::uint32_t>(h.command));
  append_be(out, h.sequence);
  append_be(out, h.device_id);
  append_be(out, std::uint32_t{h.in ? 1u : 0u});
  append_be(out, h.endpoint);
  out.resize(at + kHeaderBytes, '\0');
  switch (h.command) {
    case Command::submit:
      store_be(out, at + 24, h.length);
      store_be(out, at + 28, h.start_frame);
      store_be(out, at + 32, h.packets);
      std::memcpy(out.data() + at + 40, h.setup.data(), h.setup.size());
      break;
    case Command::submitted:
      store_be(out, at + 20, h.status);
      store_be(out, at + 24, h.length);
      store_be(out, at + 28, h.start_frame);
      store_be(out, at + 32, h.packets);
      break;
    case Command::unlink:
      store_be(out, at + 20, h.unlink);
      break;
    case Command::unlinked:
      store_be(out, at + 20, h.status);
      break;
  }
}

IsochronousPacket decode_isochronous_packet(Bytes b) {
  return {load_be<std::uint32_t>(b, 0), load_be<std::uint32_t>(b, 4), load_be<std::uint32_t>(b, 8),
          load_be<std::int32_t>(b, 12)};
}

void append_isochronous_packet(std::string& out, const IsochronousPacket& p) {
  for (const std::uint32_t v : {p.offset, p.length, p.actual_length}) append_be(out, v);
  append_be(out, p.status);
}

SetupPacket decode_setup(const std::array<std::uint8_t, 8>& b) {
  return {b[0], b[1], load_le<std::uint16_t>(b, 2), load_le<std::uint16_t>(b, 4),
          load_le<std::uint16_t>(b, 6)};
}

std::array<std::uint8_t, 8> encode_setup(const SetupPacket& s) {
  std::array<std::uint8_t, 8> b{s.request_type, s.request};
  store_le(b, 2, s.value);
  store_le(b, 4, s.index);
  store_le(b, 6, s.length);
  return b;
}

}  // namespace rigor::usbip
