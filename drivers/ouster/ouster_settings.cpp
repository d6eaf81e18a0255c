#include "drivers/ouster/ouster_settings.h"

#include <arpa/inet.h>

namespace rigor::ouster {
namespace {

std::string local_ipv4(const ConfigNode& n, std::string fallback) {
  std::string text = n.text_or("address", std::move(fallback));
  in_addr parsed{};
  if (inet_pton(AF_INET, text.c_str(), &parsed) != 1)
    throw n.error("address", "expected an IPv4 address of this machine, or 0.0.0.0, got \"" + text + "\"");
  return text;
}
std::uint16_t port_or(const ConfigNode& n, std::string_view key, std::uint16_t fallback) {
  return static_cast<std::uint16_t>(n.integer_or(key, fallback, {.min = 0, .max = 65535}));
}

}  // namespace

SourceSettings read_source_settings(const ChannelConfig& config) {
  const ConfigNode& n = config.params;
  SourceSettings s;
  const SampleKind kind = config.kind;
  if (kind != SampleKind::point_cloud && kind != SampleKind::image && kind != SampleKind::range_image &&
      kind != SampleKind::imu)
    throw n.error("kind",
                  "expected point_cloud, image, range_image or imu: what this driver takes from the sensor; "
                  "got another kind");
  if (n.has("metadata")) s.metadata = n.base_dir() / n.text("metadata");
  if (n.has("file")) {
    s.file = n.base_dir() / n.text("file");
    for (const char* key :
         {"host", "http_port", "tcp_port", "configure", "ready_s", "address", "socket_buffer_bytes"})
      if (n.has(key)) throw n.error(key, "expected either `file` or keys of the network, got both");
    if (s.metadata.empty())
      throw n.error("file",
                    "expected `metadata` beside it: the JSON that the sensor gave when it was recorded");
  } else {
    s.host = n.text_or("host", "");
    s.http_port =
        static_cast<std::uint16_t>(n.integer_or("http_port", s.http_port, {.min = 1, .max = 65535}));
    s.tcp_port = port_or(n, "tcp_port", s.tcp_port);
    if (n.has("configure")) s.configure = n.map("configure").json();
    if (!s.configure.empty() && s.host.empty())
      throw n.error("configure", "expected `host` beside it: the sensor to be configured");
    s.ready = seconds_from(n.number_or("ready_s", s.ready.seconds(), {.min = 0.1, .max = 600}));
    s.address = local_ipv4(n, s.address);
    s.socket_buffer_bytes =
        n.integer_or("socket_buffer_bytes", s.socket_buffer_bytes, {.min = 65536, .max = 1 << 30});
  }
  s.lidar_port = port_or(n, "lidar_port", 0);
  s.imu_port = port_or(n, "imu_port", 0);
  s.frame_id = n.text_or("frame_id", config.name.substr(0, config.name.find('.')));
  const auto field = [&](const char* key, const char* fallback) {
    return *field_named(n.choice_or(key, {"reflectivity", "signal", "near_infrared"}, fallback));
  };
  if (kind == SampleKind::point_cloud) s.stream.remission = field("remission", "reflectivity");
  if (kind == SampleKind::range_image) s.stream.image = ImageOptions{.field = Field::range};
  if (kind == SampleKind::image) {
    ImageOptions image{.field = field("field", "signal")};
    const bool eight = image.field == Field::reflectivity;
    image.format =
        *pixel_format_from(n.choice_or("pixel_format", {"Mono8", "Mono16"}, eight ? "Mono8" : "Mono16"));
    if (image.format == PixelFormat::mono8)
      image.full_scale = n.number_or("full_scale", eight ? 255 : 2000, {.min = 1, .max = 65535});
    s.stream.image = image;
  }
  const std::string time = n.choice_or("time", {"device", "utc", "arrival"}, "device");
  s.stream.time = time == "utc"       ? packet_lidar::TimeSource::utc
                  : time == "arrival" ? packet_lidar::TimeSource::arrival
                                      : packet_lidar::TimeSource::device;
  if (n.has("utc_offset_s")) s.utc_offset = seconds_from(n.number("utc_offset_s", {.min = -1e6, .max = 1e6}));
  s.buffers = static_cast<std::size_t>(n.integer_or("buffers", 8, {.min = 2, .max = 256}));
  return s;
}

EmulatorSettings read_emulator_settings(const ConfigNode& n) {
  EmulatorSettings s;
  s.address = local_ipv4(n, s.address);
  s.http_port = port_or(n, "http_port", s.http_port);
  s.tcp_port = port_or(n, "tcp_port", s.tcp_port);
  s.product = n.text_or("product", s.product);
  s.serial = n.text_or("serial", s.serial);
  if (s.serial.empty() || s.serial.size() > 12 ||
      s.serial.find_first_not_of("0123456789") != std::string::npos)
    throw n.error("serial", "expected up to 12 digits, got \"" + s.serial + "\"");
  s.firmware = n.text_or("firmware", s.firmware);
  s.start_up = seconds_from(n.number_or("start_up_ms", 0, {.min = 0, .max = 120'000}) * 1e-3);
  s.imu_rate_hz = n.number_or("imu_rate_hz", s.imu_rate_hz, {.min = 0, .max = 1000});
  if (n.has("config")) s.config = n.map("config").json();
  s.pcap = n.text_or("pcap", "");
  return s;
}

}  // namespace rigor::ouster
