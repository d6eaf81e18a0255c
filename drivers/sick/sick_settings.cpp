#include "drivers/sick/sick_settings.h"

#include <cmath>
#include <numbers>

namespace rigor::sick {
namespace {

constexpr double kDegPerRad = 180 / std::numbers::pi;

std::uint32_t read_hash(const ConfigNode& n, std::string_view key) {
  const std::string text = n.text(key);
  const bool hex = text.size() == 8 && text.find_first_not_of("0123456789abcdefABCDEF") == std::string::npos;
  if (!hex) throw n.error(key, "expected 8 hexadecimal digits in quotes, such as \"F4724744\", got " + text);
  return static_cast<std::uint32_t>(std::stoul(text, nullptr, 16));
}

}  // namespace

ChannelSettings read_channel_settings(const ChannelConfig& config, bool needs_address) {
  const ConfigNode& n = config.params;
  ChannelSettings s;
  s.address = needs_address ? n.text("address") : n.text_or("address", "");
  if (needs_address && s.address.empty())
    throw n.error("address", "expected a host name or address, got \"\"");
  s.port = static_cast<std::uint16_t>(n.integer_or("port", 2112, {.min = 1, .max = 65535}));
  s.frame_id = n.text_or("frame_id", config.name);
  s.timeout = seconds_from(n.number_or("timeout_ms", 3000, {.min = 50, .max = 120000}) * 1e-3);
  s.buffers = static_cast<std::size_t>(n.integer_or("buffers", 16, {.min = 3, .max = 1000}));
  s.zero_index_deg =
      kAheadDeg + n.number_or("zero_index_deg", kZeroIndexDeg - kAheadDeg, {.min = -180, .max = 180});
  s.transport_delay = seconds_from(n.number_or("transport_delay_us", 0, {.min = 0, .max = 1e6}) * 1e-6);
  s.transport_sigma = seconds_from(n.number_or("transport_sigma_us", 200, {.min = 0, .max = 1e6}) * 1e-6);

  Wish& w = s.wish;
  w.where = config.name;
  w.level = static_cast<std::uint8_t>(n.integer_or("access_level", 3, {.min = 2, .max = 4}));
  if (n.has("password_hash")) w.password_hash = read_hash(n, "password_hash");
  w.output_interval =
      static_cast<std::uint16_t>(n.integer_or("output_interval", 1, {.min = 1, .max = 50000}));
  if (config.period.ns() > 0) w.scan_frequency_hz = w.output_interval / config.period.seconds();
  if (n.has("resolution_deg")) w.resolution_deg = n.number("resolution_deg", {.min = 0.01, .max = 6});
  if (n.has("start_deg")) w.start_deg = n.number("start_deg", {.min = -180, .max = 180}) + kAheadDeg;
  if (n.has("stop_deg")) w.stop_deg = n.number("stop_deg", {.min = -180, .max = 180}) + kAheadDeg;
  if (w.start_deg && w.stop_deg && *w.start_deg >= *w.stop_deg)
    throw n.error("stop_deg", "expected an angle beyond `start_deg` (scans run anticlockwise)");
  if (n.has("echoes")) {
    const auto e = n.choice("echoes", {"first", "all", "last"});
    w.echoes = e == "first" ? EchoFilter::first : e == "all" ? EchoFilter::all : EchoFilter::last;
  }
  const auto rssi = n.choice_or("rssi", {"device", "off", "8_bit", "16_bit"}, "device");
  w.rssi = rssi == "off"      ? Rssi::off
           : rssi == "8_bit"  ? Rssi::bits8
           : rssi == "16_bit" ? Rssi::bits16
                              : Rssi::device;
  return s;
}

ScannerConfig read_scanner(const ConfigNode& n, const models::LidarScan* scan) {
  const auto family = n.choice_or("device", {"lms1xx", "lms5xx", "tim"}, "lms1xx");
  ScannerConfig c = scanner_config(family == "lms5xx" ? Family::lms5xx
                                   : family == "tim"  ? Family::tim
                                                      : Family::lms1xx);
  if (scan) {
    // Beams of a sensor model lie between the columns' azimuths as its rotor turns; a clockwise one measures
    // the same.
    const double step = scan->rotation_radps * scan->column_period_s * kDegPerRad;
    if (scan->kind != models::LidarScanKind::rotor || scan->beams.size() != 1 || !(std::abs(step) > 0))
      throw n.error(n.has("sensor") ? "sensor" : "",
                    "expected the sensor model of a LiDAR that turns and has one beam, as these scanners "
                    "do (configs/sensors/sick-*.yaml), got another kind of LiDAR");
    const double first = scan->start_azimuth_rad * kDegPerRad;
    const double last = first + step * (scan->columns - 1);
    c.pattern = {std::min(first, last) + kAheadDeg, std::abs(step), scan->columns};
    c.scan_frequency_hz = std::abs(scan->rotation_radps) / (2 * std::numbers::pi);
  } else {
    const ConfigNode s = n.map("scan");
    c.scan_frequency_hz = s.number("rotation_hz", {.min = 0, .max = 1000, .exclusive_min = true});
    const double start = s.number("start_deg", {.min = -180, .max = 180});
    const double end = s.number("end_deg", {.min = start, .max = 180});
    const double step = s.number("step_deg", {.min = 0.01, .max = 6});
    s.finish();
    c.pattern = {start + kAheadDeg, step, static_cast<std::uint32_t>(std::lround((end - start) / step)) + 1};
  }
  // Steps are told in 1/10000 degree; a third of a degree is meant as one.
  c.pattern.step_deg = step_deg(static_cast<std::uint32_t>(std::lround(c.pattern.step_deg * 1e4)));
  c.name = n.text_or("device_name", c.name);
  c.firmware = n.text_or("firmware", c.firmware);
  c.location = n.text_or("location", c.location);
  c.serial_number =
      static_cast<std::uint32_t>(n.integer_or("serial_number", 1, {.min = 0, .max = 4294967295.0}));
  c.rssi_bits = static_cast<unsigned>(n.integer_or("rssi_bits", c.rssi_bits, {.min = 8, .max = 16}));
  c.echoes = static_cast<std::uint32_t>(n.integer_or("max_echoes", c.echoes, {.min = 1, .max = kMaxEchoes}));
  c.distance_scale = static_cast<float>(
      n.integer_or("distance_scale", static_cast<std::int64_t>(c.distance_scale), {.min = 1, .max = 2}));
  c.processing = seconds_from(n.number_or("processing_ms", 0.5, {.min = 0, .max = 1000}) * 1e-3);
  if (auto s = check(c); !s) throw n.error("", s.error().message);
  return c;
}

}  // namespace rigor::sick
