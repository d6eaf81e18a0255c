#include "drivers/aravis/gvcp_codec.h"

#include <algorithm>
#include <cstring>

#include "rt-core/device_text.h"

namespace rigor::gige {
namespace {

constexpr std::uint8_t kCommandKey = 0x42;

std::string fixed_string(Bytes b, std::size_t at, std::size_t size) {
  const auto field = b.subspan(at, size);
  const auto end = std::find(field.begin(), field.end(), std::uint8_t{0});
  return device_text(std::string(field.begin(), end));
}

void put_string(Datagram& d, std::size_t at, std::size_t size, const std::string& s) {
  // One byte stays for the terminator that clients rely on.
  std::memcpy(d.data() + at, s.data(), std::min(s.size(), size - 1));
}

Datagram command(GvcpCommand c, std::uint16_t id, std::uint8_t flags, std::size_t payload) {
  if (payload > kGvcpMaxPayload) return {};
  Datagram d(kGvcpHeaderSize + payload);
  d[0] = kCommandKey;
  d[1] = flags;
  store_be(d, 2, static_cast<std::uint16_t>(c));
  store_be(d, 4, static_cast<std::uint16_t>(payload));
  store_be(d, 6, id);
  return d;
}

DecodeStatus decode_read_register(Bytes p, ReadRegisterCmd& c) noexcept {
  if (p.empty() || p.size() % 4 != 0 || p.size() > kGvcpMaxPayload) return DecodeStatus::bad_payload;
  c.addresses.count = p.size() / 4;
  for (std::size_t i = 0; i < c.addresses.count; ++i) {
    c.addresses.items[i] = load_be<std::uint32_t>(p, 4 * i);
    if (c.addresses.items[i] % 4 != 0) return DecodeStatus::bad_alignment;
  }
  return DecodeStatus::ok;
}

DecodeStatus decode_write_register(Bytes p, WriteRegisterCmd& c) noexcept {
  if (p.empty() || p.size() % 8 != 0 || p.size() > kGvcpMaxPayload) return DecodeStatus::bad_payload;
  c.writes.count = p.size() / 8;
  for (std::size_t i = 0; i < c.writes.count; ++i) {
    c.writes.items[i] = {load_be<std::uint32_t>(p, 8 * i), load_be<std::uint32_t>(p, 8 * i + 4)};
    if (c.writes.items[i].address % 4 != 0) return DecodeStatus::bad_alignment;
  }
  return DecodeStatus::ok;
}

DecodeStatus decode_resend(Bytes p, std::uint8_t flags, PacketResendCmd& c) noexcept {
  c.extended_ids = (flags & gvcp_flag::kExtendedIds) != 0;
  if (p.size() != (c.extended_ids ? 20U : 12U)) return DecodeStatus::bad_payload;
  c.stream_channel = load_be<std::uint16_t>(p, 0);
  if (c.extended_ids) {
    c.first_packet = load_be<std::uint32_t>(p, 4);
    c.last_packet = load_be<std::uint32_t>(p, 8);
    c.block_id = load_be<std::uint64_t>(p, 12);
  } else {
    c.block_id = load_be<std::uint16_t>(p, 2);
    c.first_packet = load_be<std::uint32_t>(p, 4) & 0xFFFFFF;
    c.last_packet = load_be<std::uint32_t>(p, 8) & 0xFFFFFF;
  }
  return c.first_packet <= c.last_packet ? DecodeStatus::ok : DecodeStatus::bad_payload;
}

DecodeStatus decode_body(GvcpRequest& out, Bytes p) noexcept {
  switch (static_cast<GvcpCommand>(out.command)) {
    case GvcpCommand::discovery_cmd:
      out.body = DiscoveryCmd{};
      return p.empty() ? DecodeStatus::ok : DecodeStatus::bad_payload;
    case GvcpCommand::force_ip_cmd: {
      if (p.size() != 56) return DecodeStatus::bad_payload;
      ForceIpCmd c;
      std::copy_n(p.begin() + 2, 6, c.mac.begin());
      c.ip = load_be<std::uint32_t>(p, 20);
      c.mask = load_be<std::uint32_t>(p, 36);
      c.gateway = load_be<std::uint32_t>(p, 52);
      out.body = c;
      return DecodeStatus::ok;
    }
    case GvcpCommand::read_register_cmd:
      return decode_read_register(p, out.body.emplace<ReadRegisterCmd>());
    case GvcpCommand::write_register_cmd:
      return decode_write_register(p, out.body.emplace<WriteRegisterCmd>());
    case GvcpCommand::read_memory_cmd: {
      if (p.size() != 8) return DecodeStatus::bad_payload;
      const ReadMemoryCmd c{load_be<std::uint32_t>(p, 0), load_be<std::uint16_t>(p, 6)};
      out.body = c;
      if (c.count == 0 || c.count > kGvcpMaxReadMemory) return DecodeStatus::bad_payload;
      return c.address % 4 == 0 && c.count % 4 == 0 ? DecodeStatus::ok : DecodeStatus::bad_alignment;
    }
    case GvcpCommand::write_memory_cmd: {
      if (p.size() <= 4 || p.size() > kGvcpMaxPayload) return DecodeStatus::bad_payload;
      const WriteMemoryCmd c{load_be<std::uint32_t>(p, 0), p.subspan(4)};
      out.body = c;
      return c.address % 4 == 0 && c.data.size() % 4 == 0 ? DecodeStatus::ok : DecodeStatus::bad_alignment;
    }
    case GvcpCommand::packet_resend_cmd:
      return decode_resend(p, out.flags, out.body.emplace<PacketResendCmd>());
    case GvcpCommand::action_cmd: {
      const bool scheduled = (out.flags & gvcp_flag::kScheduled) != 0;
      if (p.size() != 20 && (p.size() != 12 || scheduled)) return DecodeStatus::bad_payload;
      ActionCmd c{
          load_be<std::uint32_t>(p, 0), load_be<std::uint32_t>(p, 4), load_be<std::uint32_t>(p, 8), {}};
      if (scheduled) c.time_ticks = load_be<std::uint64_t>(p, 12);
      out.body = c;
      return DecodeStatus::ok;
    }
    default:
      out.body = UnknownCmd{};
      return DecodeStatus::ok;
  }
}

DiscoveryAck discovery_from(Bytes p) {
  DiscoveryAck d;
  d.version_major = load_be<std::uint16_t>(p, 0);
  d.version_minor = load_be<std::uint16_t>(p, 2);
  d.device_mode = load_be<std::uint32_t>(p, 4);
  std::copy_n(p.begin() + 10, 6, d.mac.begin());
  d.supported_ip_configuration = load_be<std::uint32_t>(p, 16);
  d.current_ip_configuration = load_be<std::uint32_t>(p, 20);
  d.ip = load_be<std::uint32_t>(p, 36);
  d.mask = load_be<std::uint32_t>(p, 52);
  d.gateway = load_be<std::uint32_t>(p, 68);
  d.manufacturer = fixed_string(p, 72, 32);
  d.model = fixed_string(p, 104, 32);
  d.version = fixed_string(p, 136, 32);
  d.manufacturer_info = fixed_string(p, 168, 48);
  d.serial = fixed_string(p, 216, 16);
  d.user_name = fixed_string(p, 232, 16);
  return d;
}

}  // namespace

const char* to_string(GvStatus s) {
  switch (s) {
    case GvStatus::success:
      return "success";
    case GvStatus::not_implemented:
      return "not implemented";
    case GvStatus::invalid_parameter:
      return "invalid parameter";
    case GvStatus::invalid_address:
      return "invalid address";
    case GvStatus::write_protect:
      return "write protect";
    case GvStatus::bad_alignment:
      return "bad alignment";
    case GvStatus::access_denied:
      return "access denied";
    case GvStatus::busy:
      return "busy";
    case GvStatus::local_problem:
      return "local problem";
    case GvStatus::packet_unavailable:
      return "packet unavailable";
    case GvStatus::invalid_header:
      return "invalid header";
    case GvStatus::no_reference_time:
      return "no reference time: the device's clock follows no PTP master";
    case GvStatus::overflow:
      return "overflow: the device's queue is full";
    case GvStatus::action_late:
      return "action late";
    case GvStatus::error:
      return "error";
  }
  return "unknown status";
}

DecodeStatus decode_gvcp_request(Bytes datagram, GvcpRequest& out) noexcept {
  if (datagram.size() < kGvcpHeaderSize || datagram[0] != kCommandKey) return DecodeStatus::not_gvcp;
  out.flags = datagram[1];
  out.command = load_be<std::uint16_t>(datagram, 2);
  out.request_id = load_be<std::uint16_t>(datagram, 6);
  out.body = UnknownCmd{};
  if (out.request_id == 0 || kGvcpHeaderSize + load_be<std::uint16_t>(datagram, 4) != datagram.size()) {
    return DecodeStatus::not_gvcp;
  }
  return decode_body(out, datagram.subspan(kGvcpHeaderSize));
}

DecodeStatus decode_gvcp_ack(Bytes datagram, GvcpAck& out) {
  if (datagram.size() < kGvcpHeaderSize || datagram[0] == kCommandKey ||
      kGvcpHeaderSize + load_be<std::uint16_t>(datagram, 4) != datagram.size()) {
    return DecodeStatus::not_gvcp;
  }
  out.status = static_cast<GvStatus>(load_be<std::uint16_t>(datagram, 0));
  out.command = load_be<std::uint16_t>(datagram, 2);
  out.ack_id = load_be<std::uint16_t>(datagram, 6);
  out.body = EmptyAck{};
  const Bytes p = datagram.subspan(kGvcpHeaderSize);
  if (p.empty()) {
    const auto c = static_cast<GvcpCommand>(out.command);
    const bool may_be_empty = c == GvcpCommand::force_ip_ack || c == GvcpCommand::action_ack;
    return out.status != GvStatus::success || may_be_empty ? DecodeStatus::ok : DecodeStatus::bad_payload;
  }
  switch (static_cast<GvcpCommand>(out.command)) {
    case GvcpCommand::discovery_ack:
      if (p.size() < kDiscoveryAckSize) return DecodeStatus::bad_payload;
      out.body = discovery_from(p);
      return DecodeStatus::ok;
    case GvcpCommand::read_register_ack: {
      if (p.size() % 4 != 0 || p.size() > kGvcpMaxPayload) return DecodeStatus::bad_payload;
      auto& a = out.body.emplace<ReadRegisterAck>();
      a.values.count = p.size() / 4;
      for (std::size_t i = 0; i < a.values.count; ++i) a.values.items[i] = load_be<std::uint32_t>(p, 4 * i);
      return DecodeStatus::ok;
    }
    case GvcpCommand::write_register_ack:
      if (p.size() != 4) return DecodeStatus::bad_payload;
      out.body = WriteRegisterAck{load_be<std::uint16_t>(p, 2)};
      return DecodeStatus::ok;
    case GvcpCommand::read_memory_ack:
      if (p.size() <= 4 || p.size() > kGvcpMaxPayload) return DecodeStatus::bad_payload;
      out.body = ReadMemoryAck{load_be<std::uint32_t>(p, 0), p.subspan(4)};
      return DecodeStatus::ok;
    case GvcpCommand::write_memory_ack:
      if (p.size() != 4) return DecodeStatus::bad_payload;
      out.body = WriteMemoryAck{load_be<std::uint16_t>(p, 2)};
      return DecodeStatus::ok;
    case GvcpCommand::pending_ack:
      if (p.size() != 4) return DecodeStatus::bad_payload;
      out.body = PendingAck{load_be<std::uint16_t>(p, 2)};
      return DecodeStatus::ok;
    default:
      return DecodeStatus::ok;
  }
}

Datagram encode_discovery_cmd(std::uint16_t id, bool allow_broadcast_ack) {
  const int flags = gvcp_flag::kAckRequired | (allow_broadcast_ack ? gvcp_flag::kBroadcastAck : 0);
  return command(GvcpCommand::discovery_cmd, id, static_cast<std::uint8_t>(flags), 0);
}

Datagram encode_read_register_cmd(std::uint16_t id, std::span<const std::uint32_t> addresses) {
  auto d = command(GvcpCommand::read_register_cmd, id, gvcp_flag::kAckRequired, 4 * addresses.size());
  for (std::size_t i = 0; i < addresses.size() && !d.empty(); ++i) store_be(d, 8 + 4 * i, addresses[i]);
  return d;
}

Datagram encode_write_register_cmd(std::uint16_t id, std::span<const RegisterWrite> writes) {
  auto d = command(GvcpCommand::write_register_cmd, id, gvcp_flag::kAckRequired, 8 * writes.size());
  for (std::size_t i = 0; i < writes.size() && !d.empty(); ++i) {
    store_be(d, 8 + 8 * i, writes[i].address);
    store_be(d, 12 + 8 * i, writes[i].value);
  }
  return d;
}

Datagram encode_read_memory_cmd(std::uint16_t id, const ReadMemoryCmd& c) {
  auto d = command(GvcpCommand::read_memory_cmd, id, gvcp_flag::kAckRequired, 8);
  store_be(d, 8, c.address);
  store_be(d, 14, c.count);
  return d;
}

Datagram encode_write_memory_cmd(std::uint16_t id, std::uint32_t address, Bytes data) {
  auto d = command(GvcpCommand::write_memory_cmd, id, gvcp_flag::kAckRequired, 4 + data.size());
  if (d.empty()) return d;
  store_be(d, 8, address);
  std::copy(data.begin(), data.end(), d.begin() + 12);
  return d;
}

Datagram encode_packet_resend_cmd(std::uint16_t id, const PacketResendCmd& c) {
  auto d = command(GvcpCommand::packet_resend_cmd, id,
                   c.extended_ids ? gvcp_flag::kExtendedIds : std::uint8_t{0}, c.extended_ids ? 20 : 12);
  store_be(d, 8, c.stream_channel);
  if (c.extended_ids) {
    store_be(d, 12, c.first_packet);
    store_be(d, 16, c.last_packet);
    store_be(d, 20, c.block_id);
  } else {
    store_be(d, 10, static_cast<std::uint16_t>(c.block_id));
    store_be(d, 12, c.first_packet & 0xFFFFFF);
    store_be(d, 16, c.last_packet & 0xFFFFFF);
  }
  return d;
}

Datagram encode_action_cmd(std::uint16_t id, const ActionCmd& c) {
  const auto flags = gvcp_flag::kAckRequired | (c.time_ticks ? gvcp_flag::kScheduled : 0);
  auto d = command(GvcpCommand::action_cmd, id, static_cast<std::uint8_t>(flags), c.time_ticks ? 20 : 12);
  store_be(d, 8, c.device_key);
  store_be(d, 12, c.group_key);
  store_be(d, 16, c.group_mask);
  if (c.time_ticks) store_be(d, 20, *c.time_ticks);
  return d;
}

Datagram encode_ack(GvStatus status, std::uint16_t ack_command, std::uint16_t id, Bytes payload) {
  if (payload.size() > kGvcpMaxPayload) return {};
  Datagram d(kGvcpHeaderSize + payload.size());
  store_be(d, 0, static_cast<std::uint16_t>(status));
  store_be(d, 2, ack_command);
  store_be(d, 4, static_cast<std::uint16_t>(payload.size()));
  store_be(d, 6, id);
  std::copy(payload.begin(), payload.end(), d.begin() + kGvcpHeaderSize);
  return d;
}

Datagram encode_discovery_ack(std::uint16_t id, const DiscoveryAck& a) {
  Datagram p(kDiscoveryAckSize);
  store_be(p, 0, a.version_major);
  store_be(p, 2, a.version_minor);
  store_be(p, 4, a.device_mode);
  std::copy(a.mac.begin(), a.mac.end(), p.begin() + 10);
  store_be(p, 16, a.supported_ip_configuration);
  store_be(p, 20, a.current_ip_configuration);
  store_be(p, 36, a.ip);
  store_be(p, 52, a.mask);
  store_be(p, 68, a.gateway);
  put_string(p, 72, 32, a.manufacturer);
  put_string(p, 104, 32, a.model);
  put_string(p, 136, 32, a.version);
  put_string(p, 168, 48, a.manufacturer_info);
  put_string(p, 216, 16, a.serial);
  put_string(p, 232, 16, a.user_name);
  return encode_ack(GvStatus::success, static_cast<std::uint16_t>(GvcpCommand::discovery_ack), id, p);
}

Datagram encode_read_register_ack(std::uint16_t id, std::span<const std::uint32_t> values) {
  Datagram p(4 * values.size());
  for (std::size_t i = 0; i < values.size(); ++i) store_be(p, 4 * i, values[i]);
  return encode_ack(GvStatus::success, static_cast<std::uint16_t>(GvcpCommand::read_register_ack), id, p);
}

Datagram encode_write_ack(GvStatus status, GvcpCommand ack_command, std::uint16_t id, std::uint16_t index) {
  std::array<std::uint8_t, 4> p{};
  store_be(p, 2, index);
  return encode_ack(status, static_cast<std::uint16_t>(ack_command), id, p);
}

Datagram encode_read_memory_ack(std::uint16_t id, std::uint32_t address, Bytes data) {
  Datagram p(4 + data.size());
  store_be(p, 0, address);
  std::copy(data.begin(), data.end(), p.begin() + 4);
  return encode_ack(GvStatus::success, static_cast<std::uint16_t>(GvcpCommand::read_memory_ack), id, p);
}

Datagram encode_pending_ack(std::uint16_t id, std::uint16_t time_to_completion_ms) {
  return encode_write_ack(GvStatus::success, GvcpCommand::pending_ack, id, time_to_completion_ms);
}

}  // namespace rigor::gige
