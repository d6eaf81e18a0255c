#include "drivers/ouster/ouster_settings.h"

namespace rigor::ouster {

using packet_lidar::read_port;

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
  read_packet_settings(config, {"host", "http_port", "tcp_port", "configure", "ready_s"}, s);
  if (!s.file.empty()) {
    if (s.metadata.empty())
      throw n.error("file",
                    "expected `metadata` beside it: the JSON that the sensor gave when it was recorded");
  } else {
    s.host = n.text_or("host", "");
    s.http_port = read_port(n, "http_port", s.http_port, 1);
    s.tcp_port = read_port(n, "tcp_port", s.tcp_port);
    if (n.has("configure")) s.configure = n.map("configure").json();
    if (!s.configure.empty() && s.host.empty())
      throw n.error("configure", "expected `host` beside it: the sensor to be configured");
    s.ready = seconds_from(n.number_or("ready_s", s.ready.seconds(), {.min = 0.1, .max = 600}));
  }
  s.lidar_port = read_port(n, "lidar_port", 0);
  s.imu_port = read_port(n, "imu_port", 0);
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
  s.stream.time = packet_lidar::read_time_source(n);
  s.utc_offset = packet_lidar::read_utc_offset(n);
  return s;
}

EmulatorSettings read_emulator_settings(const ConfigNode& n) {
  EmulatorSettings s;
  s.address = packet_lidar::read_ipv4(n, "address", s.address);
  s.http_port = read_port(n, "http_port", s.http_port);
  s.tcp_port = read_port(n, "tcp_port", s.tcp_port);
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
