#include "drivers/usb/usb_settings.h"

#include <algorithm>

namespace rigor::usb {

LinkSettings read_link_settings(const ConfigNode& n, bool bulk) {
  LinkSettings s;
  const std::string transport = n.choice_or("transport", {"usb", "tty", "tcp"}, "usb");
  if (transport == "usb") {
    s.transport = Transport::usb;
    const auto id = [&](const char* key, std::uint16_t fallback) {
      if (bulk && !n.has(key)) (void)n.integer(key);  // says that it is missing
      return static_cast<std::uint16_t>(n.integer_or(key, fallback, {.min = 0, .max = 65535}));
    };
    s.usb.vendor = id("vendor", s.usb.vendor);
    s.usb.product = id("product", s.usb.product);
    s.usb.path = n.text_or("usb_path", "");
    if (bulk) {
      s.usb.serial = n.text_or("serial", "");
      s.usb.interface = static_cast<int>(n.integer_or("interface", 0, {.min = 0, .max = 255}));
      s.usb.endpoint = static_cast<std::uint8_t>(n.integer_or("endpoint", 0x81, {.min = 0, .max = 255}));
      if ((s.usb.endpoint & 0x80) == 0 || (s.usb.endpoint & 0x0f) == 0)
        throw n.error("endpoint",
                      "expected an IN endpoint, 0x81 … 0x8f, got " + std::to_string(s.usb.endpoint));
    }
  } else if (transport == "tty") {
    s.transport = Transport::tty;
    s.device = n.text_or("device", "/dev/ttyACM0");
    s.baud = static_cast<unsigned>(n.integer_or("baud", 115200, {.min = 19200, .max = 500000}));
    constexpr unsigned kSpeeds[] = {19200, 38400, 57600, 115200, 500000};
    if (std::find(std::begin(kSpeeds), std::end(kSpeeds), s.baud) == std::end(kSpeeds))
      throw n.error("baud",
                    "expected one of 19200, 38400, 57600, 115200, 500000, got " + std::to_string(s.baud));
  } else {
    s.transport = Transport::tcp;
    s.address = n.text("address");
    s.port = static_cast<std::uint16_t>(n.integer_or("port", 10940, {.min = 1, .max = 65535}));
  }
  return s;
}

ScipSettings read_scip_settings(const ChannelConfig& config) {
  const ConfigNode& n = config.params;
  ScipSettings s;
  (void)n.choice_or("protocol", {"scip"}, "scip");
  if (config.kind != SampleKind::point_cloud)
    throw n.error("", "expected `kind: point_cloud`, which is what a scanner gives");
  s.link = read_link_settings(n, false);
  s.serial = n.text_or("serial", "");
  s.link.usb.serial = s.serial;
  ScanSettings& scan = s.client.scan;
  const auto step = [&](const char* key) -> std::optional<std::uint32_t> {
    if (!n.has(key)) return std::nullopt;
    return static_cast<std::uint32_t>(n.integer(key, {.min = 0, .max = 9999}));
  };
  scan.first_step = step("start_step");
  scan.last_step = step("end_step");
  if (scan.first_step && scan.last_step && *scan.first_step > *scan.last_step)
    throw n.error("end_step", "expected a step not before start_step, " + std::to_string(*scan.first_step) +
                                  ", got " + std::to_string(*scan.last_step));
  scan.cluster = static_cast<std::uint32_t>(n.integer_or("cluster", 1, {.min = 1, .max = 99}));
  scan.skip = static_cast<std::uint32_t>(n.integer_or("skip", 0, {.min = 0, .max = 9}));
  scan.intensity = n.flag_or("intensity", false);
  const auto characters = n.integer_or("characters", 3, {.min = 2, .max = 3});
  scan.two_characters = characters == 2;
  if (scan.two_characters && scan.intensity)
    throw n.error("characters", "expected 3 with `intensity: true`: ME knows no other");
  s.client.clock_every = seconds_from(n.number_or("clock_every_s", 1, {.min = 0, .max = 3600}));
  s.slots = static_cast<std::size_t>(n.integer_or("slots", 16, {.min = 2, .max = 1024}));
  return s;
}

std::size_t most_points(const ScanSettings& scan) {
  constexpr std::uint32_t kMostSteps = 1440;  // of a turn of any scanner with this protocol that we know of
  const std::uint32_t first = scan.first_step.value_or(0), last = scan.last_step.value_or(kMostSteps - 1);
  return last < first ? 1 : (last - first) / std::max<std::uint32_t>(1, scan.cluster) + 1;
}

std::unique_ptr<ByteLink> make_plain_link(const LinkSettings& s) {
  switch (s.transport) {
    case Transport::tty:
      return serial::make_serial_link(s.serial_line());
    case Transport::tcp:
      return serial::make_tcp_link(
          s.address, s.port, "a scanner",
          "; is it on, is this its address (Hokuyo's own is 192.168.0.10:10940), is it in the same network?");
    case Transport::usb:
      break;
  }
  return nullptr;
}

}  // namespace rigor::usb
