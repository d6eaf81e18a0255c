#include "drivers/livox/livox_settings.h"

#include <arpa/inet.h>

#include <algorithm>

namespace rigor::livox {
namespace {

std::string ipv4_or(const ConfigNode& n, std::string_view key, std::string fallback) {
  std::string text = n.text_or(key, std::move(fallback));
  in_addr parsed{};
  if (!text.empty() && inet_pton(AF_INET, text.c_str(), &parsed) != 1)
    throw n.error(key, "expected an IPv4 address like 192.168.1.12, got \"" + text + "\"");
  return text;
}
std::uint32_t number_of(const std::string& ipv4) {
  in_addr parsed{};
  (void)inet_pton(AF_INET, ipv4.c_str(), &parsed);
  return ntohl(parsed.s_addr);
}
std::uint16_t port_or(const ConfigNode& n, std::string_view key, std::uint16_t fallback, double least = 0) {
  return static_cast<std::uint16_t>(n.integer_or(key, fallback, {.min = least, .max = 65535}));
}
DataType data_type_of(const ConfigNode& n) {
  const std::string type =
      n.choice_or("data_type", {"cartesian_mm", "cartesian_cm", "spherical"}, "cartesian_mm");
  return type == "cartesian_cm" ? DataType::cartesian_cm
         : type == "spherical"  ? DataType::spherical
                                : DataType::cartesian_mm;
}

}  // namespace

SourceSettings read_source_settings(const ChannelConfig& config) {
  const ConfigNode& n = config.params;
  SourceSettings s;
  if (config.kind != SampleKind::point_cloud && config.kind != SampleKind::imu)
    throw n.error("kind",
                  "expected point_cloud or imu: what this driver takes from the device; got another kind");
  const bool points = config.kind == SampleKind::point_cloud;
  if (n.has("file")) {
    s.file = n.base_dir() / n.text("file");
    for (const char* key : {"host", "command_port", "data_type", "ready_s", "address", "socket_buffer_bytes"})
      if (n.has(key)) throw n.error(key, "expected either `file` or keys of the network, got both");
  } else {
    s.host = ipv4_or(n, "host", "");
    s.command_port = port_or(n, "command_port", s.command_port, 1);
    if (n.has("data_type")) {
      if (s.host.empty() || !points)
        throw n.error("data_type", "expected `host` beside it, the device to be set, on a channel of points");
      s.data_type = data_type_of(n);
    }
    s.ready = seconds_from(n.number_or("ready_s", s.ready.seconds(), {.min = 0.1, .max = 600}));
    s.address = ipv4_or(n, "address", s.address);
    s.socket_buffer_bytes =
        n.integer_or("socket_buffer_bytes", s.socket_buffer_bytes, {.min = 65536, .max = 1 << 30});
  }
  s.port_given = n.has("port");
  s.port = port_or(n, "port", points ? kHostPointPort : kHostImuPort, 1);
  s.frame_id = n.text_or("frame_id", config.name.substr(0, config.name.find('.')));
  if (points) {
    const double period_ms = config.period.ns() > 0 ? config.period.seconds() * 1e3 : 100;
    s.stream.frame = seconds_from(n.number_or("frame_ms", period_ms, {.min = 1, .max = 2000}) * 1e-3);
    s.stream.drop_noise = n.flag_or("drop_noise", false);
  }
  const std::string time = n.choice_or("time", {"device", "utc", "arrival"}, "device");
  s.stream.time = time == "utc"       ? packet_lidar::TimeSource::utc
                  : time == "arrival" ? packet_lidar::TimeSource::arrival
                                      : packet_lidar::TimeSource::device;
  if (n.has("utc_offset_s"))
    s.stream.utc_offset = seconds_from(n.number("utc_offset_s", {.min = -1e6, .max = 1e6}));
  s.buffers = static_cast<std::size_t>(n.integer_or("buffers", 8, {.min = 2, .max = 256}));
  return s;
}

EmulatorSettings read_emulator_settings(const ConfigNode& n) {
  EmulatorSettings s;
  s.address = ipv4_or(n, "address", s.address);
  s.identity.ipv4 = number_of(s.address);
  s.identity.command_port = port_or(n, "command_port", s.identity.command_port);
  s.search_port = port_or(n, "search_port", s.search_port);
  s.lidar_ports = n.flag_or("lidar_ports", true);
  s.identity.serial = n.text_or("serial", s.identity.serial);
  if (s.identity.serial.empty() || s.identity.serial.size() > 16)
    throw n.error("serial", "expected up to 16 characters, got \"" + s.identity.serial + "\"");
  s.identity.start_up = seconds_from(n.number_or("start_up_ms", 0, {.min = 0, .max = 120'000}) * 1e-3);
  const std::uint32_t host = number_of(ipv4_or(n, "host", "127.0.0.1"));
  s.setup.point_host = {host, port_or(n, "point_port", kHostPointPort), kPointPort};
  s.setup.imu_host = {host, port_or(n, "imu_port", kHostImuPort), kImuPort};
  s.setup.state_host = {host, port_or(n, "state_port", kHostStatePort), kStatePort};
  s.setup.data_type = data_type_of(n);
  s.setup.imu = n.flag_or("imu", true);
  const std::string mode = n.choice_or("mode", {"sampling", "idle", "ready"}, "sampling");
  s.setup.target = mode == "idle"    ? WorkState::idle
                   : mode == "ready" ? WorkState::ready
                                     : WorkState::sampling;
  s.time = n.choice_or("time", {"none", "ptp"}, "none") == "ptp" ? TimeType::ptp : TimeType::none;
  s.pcap = n.text_or("pcap", "");
  return s;
}

}  // namespace rigor::livox
