#include "drivers/livox/livox_command.h"

#include <algorithm>

#include "rt-core/byte_order.h"
#include "sensor-hal/record/crc32.h"

namespace rigor::livox {
namespace {

constexpr std::uint8_t kStart = 0xAA;
constexpr std::size_t kSearchBytes = 24;

std::uint32_t data_checksum(Bytes data) { return record::crc32(std::as_bytes(data)); }

void append(std::vector<std::uint8_t>& to, Bytes bytes) { to.insert(to.end(), bytes.begin(), bytes.end()); }

}  // namespace

std::string_view name_of(WorkState state) {
  switch (state) {
    case WorkState::sampling:
      return "SAMPLING";
    case WorkState::idle:
      return "IDLE";
    case WorkState::error:
      return "ERROR";
    case WorkState::self_check:
      return "SELFCHECK";
    case WorkState::motor_start:
      return "MOTORSTARTUP";
    case WorkState::upgrade:
      return "UPGRADE";
    case WorkState::ready:
      return "READY";
  }
  return "unknown";
}

std::string_view text_of(ReturnCode code) {
  switch (code) {
    case ReturnCode::success:
      return "done";
    case ReturnCode::failure:
      return "it failed";
    case ReturnCode::not_now:
      return "not in its present state";
    case ReturnCode::out_of_range:
      return "the value is out of range";
    case ReturnCode::not_supported:
      return "it has no such parameter";
    case ReturnCode::reboot_needed:
      return "it takes effect after a reboot";
    case ReturnCode::read_only:
      return "the parameter can only be read";
    case ReturnCode::wrong_length:
      return "the value has a wrong length";
    case ReturnCode::wrong_count:
      return "the number of parameters is wrong";
  }
  return "an unknown reason";
}

std::uint16_t crc16(Bytes bytes) {
  std::uint32_t crc = 0xFFFF;
  for (const std::uint8_t b : bytes) {
    crc ^= static_cast<std::uint32_t>(b) << 8;
    for (int i = 0; i < 8; ++i) crc = (crc & 0x8000) != 0 ? crc << 1 ^ 0x1021 : crc << 1;
    crc &= 0xFFFF;
  }
  return static_cast<std::uint16_t>(crc);
}

std::optional<Command> parse_command(Bytes b) {
  if (b.size() < kCommandHeaderBytes || b.size() > kMaxCommandBytes || b[0] != kStart || b[1] != 0 ||
      load_le<std::uint16_t>(b, 2) != b.size() || b[10] > 1 || b[11] > 1 ||
      load_le<std::uint16_t>(b, 18) != crc16(b.first(18)))
    return {};
  Command c;
  c.sequence = load_le<std::uint32_t>(b, 4);
  c.id = load_le<CommandId>(b, 8);
  c.answer = b[10] == 1;
  c.from_lidar = b[11] == 1;
  c.data = b.subspan(kCommandHeaderBytes);
  if (load_le<std::uint32_t>(b, 20) != data_checksum(c.data)) return {};
  return c;
}

std::vector<std::uint8_t> compose_command(const Command& c) {
  std::vector<std::uint8_t> out(kCommandHeaderBytes, 0);
  append(out, c.data);
  out[0] = kStart;
  store_le(out, 2, static_cast<std::uint16_t>(out.size()));
  store_le(out, 4, c.sequence);
  store_le(out, 8, c.id);
  out[10] = c.answer ? 1 : 0;
  out[11] = c.from_lidar ? 1 : 0;
  store_le(out, 18, crc16(Bytes(out).first(18)));
  store_le(out, 20, data_checksum(c.data));
  return out;
}

std::optional<std::vector<Parameter>> parse_parameters(Bytes list, std::size_t count) {
  std::vector<Parameter> out;
  while (!list.empty()) {
    if (list.size() < 4 || out.size() == count) return {};
    const std::size_t length = load_le<std::uint16_t>(list, 2);
    if (list.size() - 4 < length) return {};
    out.push_back({load_le<Key>(list, 0), list.subspan(4, length)});
    list = list.subspan(4 + length);
  }
  if (out.size() != count) return {};
  return out;
}

void append_parameter(std::vector<std::uint8_t>& list, Key key, Bytes value) {
  append_le(list, key);
  append_le(list, static_cast<std::uint16_t>(value.size()));
  append(list, value);
}

std::vector<std::uint8_t> parameter_data(std::span<const Parameter> parameters) {
  std::vector<std::uint8_t> out;
  append_le(out, static_cast<std::uint16_t>(parameters.size()));
  append_le(out, std::uint16_t{0});
  for (const Parameter& p : parameters) append_parameter(out, p.key, p.value);
  return out;
}

std::array<std::uint8_t, 8> bytes_of(const HostAddress& host) {
  std::array<std::uint8_t, 8> out{};
  store_be(out, 0, host.ipv4);
  store_le(out, 4, host.port);
  store_le(out, 6, host.lidar_port);
  return out;
}

HostAddress host_of(Bytes value) {
  return {load_be<std::uint32_t>(value, 0), load_le<std::uint16_t>(value, 4),
          load_le<std::uint16_t>(value, 6)};
}

std::vector<std::uint8_t> search_data(const SearchAnswer& a) {
  std::vector<std::uint8_t> out(kSearchBytes, 0);
  out[0] = static_cast<std::uint8_t>(a.code);
  out[1] = a.device_type;
  std::copy_n(a.serial.begin(), std::min<std::size_t>(a.serial.size(), 16), out.begin() + 2);
  store_be(out, 18, a.ipv4);
  store_le(out, 22, a.command_port);
  return out;
}

std::optional<SearchAnswer> parse_search(Bytes data) {
  if (data.size() != kSearchBytes) return {};
  SearchAnswer a;
  a.code = static_cast<ReturnCode>(data[0]);
  a.device_type = data[1];
  const std::string_view serial(reinterpret_cast<const char*>(data.data()) + 2, 16);
  a.serial = serial.substr(0, std::min(serial.find('\0'), serial.size()));
  a.ipv4 = load_be<std::uint32_t>(data, 18);
  a.command_port = load_le<std::uint16_t>(data, 22);
  return a;
}

}  // namespace rigor::livox
