#include "drivers/lidar/packet_settings.h"

#include <arpa/inet.h>

namespace rigor::packet_lidar {

void read_packet_settings(const ChannelConfig& config, std::initializer_list<const char*> network_keys,
                          PacketSettings& s) {
  const ConfigNode& n = config.params;
  if (n.has("file")) {
    s.file = n.base_dir() / n.text("file");
    const auto refuse = [&](const char* key) {
      if (n.has(key)) throw n.error(key, "expected either `file` or keys of the network, got both");
    };
    for (const char* key : network_keys) refuse(key);
    for (const char* key : {"address", "socket_buffer_bytes"}) refuse(key);
  } else {
    s.address = read_ipv4(n, "address", s.address);
    s.socket_buffer_bytes =
        n.integer_or("socket_buffer_bytes", s.socket_buffer_bytes, {.min = 65536, .max = 1 << 30});
  }
  s.frame_id = n.text_or("frame_id", config.name.substr(0, config.name.find('.')));
  s.buffers = static_cast<std::size_t>(n.integer_or("buffers", 8, {.min = 2, .max = 256}));
}

TimeSource read_time_source(const ConfigNode& n, const char* utc) {
  const std::string time = n.choice_or("time", {"device", utc, "arrival"}, "device");
  return time == utc ? TimeSource::utc : time == "arrival" ? TimeSource::arrival : TimeSource::device;
}

std::optional<Duration> read_utc_offset(const ConfigNode& n) {
  if (!n.has("utc_offset_s")) return {};
  return seconds_from(n.number("utc_offset_s", {.min = -1e6, .max = 1e6}));
}

std::string read_ipv4(const ConfigNode& n, std::string_view key, std::string fallback) {
  const bool may_be_empty = fallback.empty();
  std::string text = n.text_or(key, std::move(fallback));
  in_addr parsed{};
  if (!(may_be_empty && text.empty()) && inet_pton(AF_INET, text.c_str(), &parsed) != 1)
    throw n.error(key, "expected an IPv4 address like 192.168.1.201, got \"" + text + "\"");
  return text;
}

std::uint16_t read_port(const ConfigNode& n, std::string_view key, std::uint16_t fallback, double least) {
  return static_cast<std::uint16_t>(n.integer_or(key, fallback, {.min = least, .max = 65535}));
}

std::uint32_t ipv4_of(const std::string& text) {
  in_addr parsed{};
  return inet_pton(AF_INET, text.c_str(), &parsed) == 1 ? ntohl(parsed.s_addr) : 0;
}

}  // namespace rigor::packet_lidar
