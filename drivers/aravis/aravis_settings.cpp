#include "drivers/aravis/aravis_settings.h"

#include <arpa/inet.h>

#include "sensor-hal/config/sample_size.h"

namespace rigor {
namespace {

Duration read_ms(const ConfigNode& n, std::string_view key, double fallback_ms, Range range) {
  return seconds_from(n.number_or(key, fallback_ms, range) * 1e-3);
}

AravisSettings::Region read_region(const ConfigNode& n) {
  constexpr double kMax = 65535;
  AravisSettings::Region r;
  r.x_px = static_cast<std::uint32_t>(n.integer_or("x_px", 0, {.min = 0, .max = kMax}));
  r.y_px = static_cast<std::uint32_t>(n.integer_or("y_px", 0, {.min = 0, .max = kMax}));
  r.width_px = static_cast<std::uint32_t>(n.integer("width_px", {.min = 1, .max = kMax}));
  r.height_px = static_cast<std::uint32_t>(n.integer("height_px", {.min = 1, .max = kMax}));
  check_picture_size(n, r.width_px, r.height_px);
  n.finish();
  return r;
}

AravisSettings::Action read_action(const ConfigNode& n) {
  AravisSettings::Action a;
  const auto key = [&n](std::string_view name, std::int64_t least) {
    return static_cast<std::uint32_t>(
        n.integer_or(name, 1, {.min = static_cast<double>(least), .max = 4294967295.0}));
  };
  a.device_key = key("device_key", 0);
  a.group_key = key("group_key", 0);
  a.group_mask = key("group_mask", 1);
  a.lead = read_ms(n, "lead_ms", 20, {.min = 1, .max = 1000});
  a.settle = seconds_from(n.number_or("settle_s", 30, {.min = 0, .max = 3600}));
  n.finish();
  return a;
}

}  // namespace

std::string default_frame_id(const std::string& channel_name) {
  return channel_name.substr(0, channel_name.find('.')) + "_optical";
}

AravisSettings read_aravis_settings(const ChannelConfig& config) {
  const ConfigNode& n = config.params;
  AravisSettings s;
  if (config.kind != SampleKind::image && config.kind != SampleKind::range_image)
    throw n.error("kind", "expected image, or range_image of a 3D camera: a camera gives nothing else");
  s.range = config.kind == SampleKind::range_image;
  s.device = n.text_or("device", "");
  s.address = n.text_or("address", "");
  if (s.device.empty() && s.address.empty())
    throw n.error({},
                  "expected `device` (id, serial, user name or MAC of a camera) or `address`, got neither; "
                  "`rigor devices` lists the cameras that are there");
  in_addr parsed{};
  if (!s.address.empty() && inet_pton(AF_INET, s.address.c_str(), &parsed) != 1)
    throw n.error("address", "expected an IPv4 address like 192.168.1.20, got \"" + s.address + "\"");
  s.interface = n.text_or("interface", "");
  s.frame_id = n.text_or("frame_id", default_frame_id(config.name));
  std::vector<std::string> formats;
  for (const PixelFormat f : kPixelFormats) formats.emplace_back(pfnc_name(f));
  formats.emplace_back(pfnc_name(PixelFormat::coord3d_c16));
  if (s.range) {
    s.format = PixelFormat::coord3d_c16;
    if (n.has("range_scale_mm"))
      s.range_scale_mm = n.number("range_scale_mm", {.min = 0, .max = 1e4, .exclusive_min = true});
    if (n.has("range_offset_mm")) s.range_offset_mm = n.number("range_offset_mm", {.min = -1e6, .max = 1e6});
    s.amplitude_scale = n.number_or("amplitude_scale", 1, {.min = 0, .max = 1e9, .exclusive_min = true});
  } else {
    s.format = *pixel_format_from(n.choice_or("pixel_format", formats, "Mono8"));
    s.part = n.text_or("part", "");
  }
  if (n.has("region")) s.region = read_region(n.map("region"));
  if (n.has("exposure_us"))
    s.exposure_us = n.number("exposure_us", {.min = 0, .max = 1e9, .exclusive_min = true});
  if (n.has("gain_db")) s.gain_db = n.number("gain_db", {.min = -100, .max = 1000});
  const auto trigger = n.choice_or("trigger", {"free_run", "software", "hardware", "action"}, "free_run");
  s.software_trigger = trigger == "software";
  s.hardware_trigger = trigger == "hardware";
  if (s.hardware_trigger) {
    s.trigger_line = n.text_or("trigger_line", "Line1");
    s.falling_edge = n.choice_or("trigger_edge", {"rising", "falling"}, "rising") == "falling";
    s.trigger_delay_us = n.number_or("trigger_delay_us", 0, {.min = 0, .max = 1e6});
  }
  s.chunks = n.choice_or("chunks", {"off", "on"}, "off") == "on";
  if (s.chunks && s.parts())
    throw n.error("chunks", "expected off: chunks of multi-part frames are not read");
  if (trigger == "action") s.action = read_action(n.map_or_absent("action"));
  s.ptp = n.choice_or("ptp", {"off", "on"}, s.action ? "on" : "off") == "on";
  if (s.action && !s.ptp)
    throw n.error("ptp", "expected on, as the time of an action command is one of the PTP clock, got off");
  if (s.triggered_by_bench() && config.period.ns() <= 0)
    throw n.error("trigger",
                  "expected a channel with a rate: " + trigger + " triggers follow the bench's grid");
  const std::string packet_size = n.text_or("packet_size", "auto");
  if (packet_size != "auto")
    s.packet_size = static_cast<std::uint32_t>(n.integer("packet_size", {.min = 576, .max = 65507}));
  s.packet_delay_ns = n.integer_or("packet_delay_ns", 0, {.min = 0, .max = 1e9});
  s.resend = n.flag_or("resend", true);
  s.first_resend_after = read_ms(n, "first_resend_ms", 1, {.min = 0, .max = 1000});
  s.packet_timeout = read_ms(n, "packet_timeout_ms", 5, {.min = 0.1, .max = 10'000});
  s.frame_retention = read_ms(n, "frame_retention_ms", 200, {.min = 1, .max = 10'000});
  s.drop_incomplete = n.choice_or("incomplete", {"mark", "drop"}, "mark") == "drop";
  s.socket_buffer_bytes =
      n.integer_or("socket_buffer_bytes", s.socket_buffer_bytes, {.min = 65536, .max = 1 << 30});
  s.packet_socket_allowed = n.choice_or("packet_socket", {"auto", "off"}, "auto") == "auto";
  s.buffers = static_cast<std::size_t>(n.integer_or("buffers", 16, {.min = 4, .max = 256}));
  if (n.has("arrival_delay_us"))
    s.arrival_delay = seconds_from(n.number("arrival_delay_us", {.min = 0, .max = 1e7}) * 1e-6);
  s.realtime_priority = static_cast<int>(n.integer_or("realtime_priority", 0, {.min = 0, .max = 98}));
  s.reconnect_after = read_ms(n, "reconnect_ms", 100, {.min = 10, .max = 60'000});
  return s;
}

}  // namespace rigor
