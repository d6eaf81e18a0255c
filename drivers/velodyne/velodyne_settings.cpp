#include "drivers/velodyne/velodyne_settings.h"

#include <algorithm>
#include <cmath>

namespace rigor::velodyne {

using packet_lidar::read_ipv4;
using packet_lidar::read_port;

SourceSettings read_source_settings(const ChannelConfig& config) {
  const ConfigNode& n = config.params;
  SourceSettings s;
  if (config.kind != SampleKind::point_cloud)
    throw n.error("kind", "expected point_cloud: a Velodyne gives nothing else; got another kind");
  read_packet_settings(config, {"port", "position_port", "from"}, s);
  if (s.file.empty()) {
    s.port = read_port(n, "port", s.port, 1);
    s.position_port = read_port(n, "position_port", s.position_port, 0);
    s.from = read_ipv4(n, "from", "");
  }
  const std::string model = n.choice_or("model", {"auto", "vlp16", "hdl32e"}, "auto");
  s.model = model_named(model);
  if (n.has("calibration")) s.calibration = n.base_dir() / n.text("calibration");
  s.rings = n.choice_or("rings", {"laser", "elevation"}, "laser") == "laser" ? RingOrder::laser
                                                                             : RingOrder::elevation;
  s.stream.unit = n.choice_or("unit", {"revolution", "packet"}, "revolution") == "packet"
                      ? CloudUnit::packet
                      : CloudUnit::revolution;
  s.stream.cut_cdeg =
      static_cast<std::uint32_t>(std::lround(n.number_or("cut_deg", 0, {.min = 0, .max = 359.99}) * 100) %
                                 static_cast<long>(kTurn_cdeg));
  s.stream.time = packet_lidar::read_time_source(n, "gps");
  if (s.stream.unit == CloudUnit::revolution && config.period.ns() > 0) s.stream.revolution = config.period;
  s.stream.max_points = most_points(s, config.period);
  return s;
}

std::size_t most_points(const SourceSettings& s, Duration period) {
  if (s.stream.unit == CloudUnit::packet) return kMaxReturns;
  // Dual returns of the denser device, where it is not known which it is.
  const DeviceFacts& f = facts_of(s.model.value_or(Model::hdl32e));
  const double returns_per_s = 2e9 * f.lasers / static_cast<double>(f.sequence_ns);
  const double turn_s = period.ns() > 0 ? std::clamp(period.seconds() * 1.25, 0.05, 0.25) : 0.21;
  return static_cast<std::size_t>(returns_per_s * turn_s) + 2 * kMaxReturns;
}

void describe_clouds(const SourceSettings& settings, ChannelDescription& description) {
  description.kind = SampleKind::point_cloud;
  description.frame_id = settings.frame_id;
  description.max_bytes = settings.stream.max_points * sizeof(LidarPoint);
}

EmulatorSettings read_emulator_settings(const ConfigNode& n) {
  EmulatorSettings s;
  s.address = read_ipv4(n, "address", s.address);
  s.port = read_port(n, "port", s.port, 1);
  s.position_port = read_port(n, "position_port", s.position_port, 1);
  s.position_rate_hz = n.number_or("position_rate_hz", s.position_rate_hz, {.min = 0, .max = 700});
  s.model = *model_named(n.choice_or("model", {"vlp16", "hdl32e"}, "vlp16"));
  const std::string returns = n.choice_or("returns", {"strongest", "last", "dual"}, "strongest");
  s.returns = returns == "dual"   ? ReturnMode::dual
              : returns == "last" ? ReturnMode::last
                                  : ReturnMode::strongest;
  s.product =
      static_cast<std::uint8_t>(n.integer_or("product", facts_of(s.model).product, {.min = 0, .max = 255}));
  const std::string pps = n.choice_or("pps", {"absent", "synchronizing", "locked", "error"}, "locked");
  for (const PpsStatus p : {PpsStatus::absent, PpsStatus::synchronizing, PpsStatus::locked, PpsStatus::error})
    if (name_of(p) == pps) s.pps = p;
  s.latitude_deg = n.number_or("latitude_deg", 0, {.min = -90, .max = 90});
  s.longitude_deg = n.number_or("longitude_deg", 0, {.min = -180, .max = 180});
  s.pcap = n.text_or("pcap", "");
  return s;
}

}  // namespace rigor::velodyne
