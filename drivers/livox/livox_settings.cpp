#include "drivers/livox/livox_settings.h"

namespace rigor::livox {
namespace {

using packet_lidar::ipv4_of;
using packet_lidar::read_ipv4;
using packet_lidar::read_port;

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
  read_packet_settings(config, {"host", "command_port", "data_type", "ready_s"}, s);
  if (s.file.empty()) {
    s.host = read_ipv4(n, "host", "");
    s.command_port = read_port(n, "command_port", s.command_port, 1);
    if (n.has("data_type")) {
      if (s.host.empty() || !points)
        throw n.error("data_type", "expected `host` beside it, the device to be set, on a channel of points");
      s.data_type = data_type_of(n);
    }
    s.ready = seconds_from(n.number_or("ready_s", s.ready.seconds(), {.min = 0.1, .max = 600}));
  }
  s.port_given = n.has("port");
  s.port = read_port(n, "port", points ? kHostPointPort : kHostImuPort, 1);
  if (points) {
    const double period_ms = config.period.ns() > 0 ? config.period.seconds() * 1e3 : 100;
    s.stream.frame = seconds_from(n.number_or("frame_ms", period_ms, {.min = 1, .max = 2000}) * 1e-3);
    s.stream.drop_noise = n.flag_or("drop_noise", false);
  }
  s.stream.time = packet_lidar::read_time_source(n);
  s.stream.utc_offset = packet_lidar::read_utc_offset(n);
  return s;
}

EmulatorSettings read_emulator_settings(const ConfigNode& n) {
  EmulatorSettings s;
  s.address = read_ipv4(n, "address", s.address);
  s.identity.ipv4 = ipv4_of(s.address);
  s.identity.command_port = read_port(n, "command_port", s.identity.command_port);
  s.search_port = read_port(n, "search_port", s.search_port);
  s.lidar_ports = n.flag_or("lidar_ports", true);
  s.identity.serial = n.text_or("serial", s.identity.serial);
  if (s.identity.serial.empty() || s.identity.serial.size() > 16)
    throw n.error("serial", "expected up to 16 characters, got \"" + s.identity.serial + "\"");
  s.identity.start_up = seconds_from(n.number_or("start_up_ms", 0, {.min = 0, .max = 120'000}) * 1e-3);
  const std::uint32_t host = ipv4_of(read_ipv4(n, "host", "127.0.0.1"));
  s.setup.point_host = {host, read_port(n, "point_port", kHostPointPort), kPointPort};
  s.setup.imu_host = {host, read_port(n, "imu_port", kHostImuPort), kImuPort};
  s.setup.state_host = {host, read_port(n, "state_port", kHostStatePort), kStatePort};
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
