#include "drivers/gnss/gnss_settings.h"

#include <arpa/inet.h>

#include <algorithm>
#include <array>

#include "sensor-hal/config/rate.h"

namespace rigor::gnss {
namespace {

constexpr std::array<OutputMessage, 17> kMessages{{
    {"pvt", UbxId::nav_pvt, config_key::kOutPvt, false},
    {"cov", UbxId::nav_cov, config_key::kOutCov, false},
    {"dop", UbxId::nav_dop, config_key::kOutDop, false},
    {"hpposllh", UbxId::nav_hpposllh, config_key::kOutHpposllh, false},
    {"sat", UbxId::nav_sat, config_key::kOutSat, false},
    {"timegps", UbxId::nav_timegps, config_key::kOutTimeGps, false},
    {"eoe", UbxId::nav_eoe, config_key::kOutEoe, false},
    {"tim_tp", UbxId::tim_tp, config_key::kOutTimTp, false},
    {"rawx", UbxId::rxm_rawx, config_key::kOutRawx, false},
    {"gga", ubx_id(0xF0, 0x00), config_key::kOutGga, true},
    {"gll", ubx_id(0xF0, 0x01), config_key::kOutGll, true},
    {"gsa", ubx_id(0xF0, 0x02), config_key::kOutGsa, true},
    {"gsv", ubx_id(0xF0, 0x03), config_key::kOutGsv, true},
    {"rmc", ubx_id(0xF0, 0x04), config_key::kOutRmc, true},
    {"vtg", ubx_id(0xF0, 0x05), config_key::kOutVtg, true},
    {"gst", ubx_id(0xF0, 0x07), config_key::kOutGst, true},
    {"zda", ubx_id(0xF0, 0x08), config_key::kOutZda, true},
}};

std::vector<std::string> read_messages(const ConfigNode& n, std::vector<std::string> fallback) {
  if (!n.has("messages")) return fallback;
  std::vector<std::string> names, known;
  for (const OutputMessage& m : kMessages) known.emplace_back(m.name);
  for (const ConfigNode& item : n.list("messages")) {
    std::string name = item.as_text();
    if (std::find(known.begin(), known.end(), name) == known.end())
      throw item.error("", "expected one of " + joined_or_none(known) + ", got \"" + name + "\"");
    names.push_back(std::move(name));
  }
  if (names.empty()) throw n.error("messages", "expected at least one message, got none");
  return names;
}

LineSettings read_line(const ConfigNode& n, bool automatic_baud, unsigned baud) {
  LineSettings line;
  const bool device = n.has("device"), address = n.has("address");
  if (device == address)
    throw n.error(
        device ? "address" : "",
        std::string("expected either `device` (a serial line) or `address` and `port` (a server), got ") +
            (device ? "both" : "neither"));
  if (device) {
    line.serial = serial::SerialSettings::parse(
        n, {.baud = baud, .parity = 'N', .least_data_bits = 7, .automatic_baud = automatic_baud});
    line.serial->device = n.text("device");
    if (line.serial->device.empty()) throw n.error("device", "expected a serial port, got \"\"");
  } else {
    line.address = n.text("address");
    if (line.address.empty()) throw n.error("address", "expected a host name or address, got \"\"");
    line.port = static_cast<std::uint16_t>(n.integer("port", {.min = 1, .max = 65535}));
  }
  return line;
}

ConfigureSettings read_configure(const ConfigNode& n, const LineSettings& line) {
  ConfigureSettings c;
  const std::string generation = n.choice_or("generation", {"auto", "8", "9"}, "auto");
  c.generation = generation == "auto" ? 0 : generation == "8" ? 8 : 9;
  const std::string interface = n.choice_or("interface", {"uart1", "uart2", "usb"}, "uart1");
  c.interface = interface == "uart1"   ? Interface::uart1
                : interface == "uart2" ? Interface::uart2
                                       : Interface::usb;
  c.messages = read_messages(n, {"pvt", "cov", "dop", "timegps", "sat", "eoe"});
  if (n.has("baud")) {
    const auto baud = n.integer("baud", {.min = 1, .max = 4e6});
    if (!serial::is_standard_baud(static_cast<unsigned>(baud)))
      throw n.error("baud", "expected one of " + serial::standard_bauds() + ", got " + std::to_string(baud));
    if (!line.serial || c.interface == Interface::usb)
      throw n.error("baud", "expected none: USB and TCP have no speed; got " + std::to_string(baud));
    c.baud = static_cast<unsigned>(baud);
  }
  n.finish();
  return c;
}

}  // namespace

std::span<const OutputMessage> output_messages() { return kMessages; }

std::string LineSettings::text() const {
  if (serial) return serial->device;
  const bool six = address.find(':') != std::string::npos;
  return (six ? "[" + address + "]" : address) + ":" + std::to_string(port);
}

std::unique_ptr<serial::ByteLink> LineSettings::make(const std::string& device,
                                                     const std::string& advice) const {
  if (!serial) return serial::make_tcp_link(address, port, device, advice);
  serial::SerialSettings s = *serial;
  if (s.baud == 0) s.baud = 38400;  // to begin with
  return serial::make_serial_link(std::move(s));
}

ChannelSettings read_channel_settings(const ChannelConfig& config, bool needs_line) {
  const ConfigNode& n = config.params;
  ChannelSettings s;
  if (config.kind != SampleKind::nav_fix && config.kind != SampleKind::register_block &&
      config.kind != SampleKind::point_cloud)
    throw n.error(
        "kind",
        "expected nav_fix, registers (all of the solution) or point_cloud (satellites in view), which "
        "a receiver gives; got another kind");
  ReceiverSettings& r = s.receiver;
  if (n.has("file")) {
    s.file = n.base_dir() / n.text("file");
    for (const char* key : {"device", "address", "port", "configure", "corrections", "pps", "log"})
      if (n.has(key)) throw n.error(key, "expected either `file` or keys of a receiver, got both");
  } else if (needs_line || n.has("device") || n.has("address")) {
    r.line = read_line(n, true, 38400);
  }
  if (ConfigNode c = n.map_or_absent("configure"); c.present()) r.configure = read_configure(c, r.line);
  if (ConfigNode c = n.map_or_absent("corrections"); c.present()) {
    r.corrections = read_line(c, false, 57600);
    c.finish();
  }
  const std::string time = n.choice_or("time", {"device", "utc", "arrival"}, "device");
  r.time = time == "utc" ? TimeSource::utc : time == "arrival" ? TimeSource::arrival : TimeSource::device;
  r.pps = n.text_or("pps", "");
  if (!r.pps.empty() && r.time != TimeSource::device)
    throw n.error("pps", "expected `time: device` with it: pulses tie the receiver's own clock down");
  r.period = config.period;
  r.output_delay = seconds_from(n.number_or("output_delay_ms", 30, {.min = 0, .max = 5000}) * 1e-3);
  r.output_delay_sigma =
      seconds_from(n.number_or("output_delay_sigma_ms", 10, {.min = 0.001, .max = 5000}) * 1e-3);
  r.range_error_m = n.number_or("range_error_m", 5, {.min = 0, .max = 1000, .exclusive_min = true});
  r.silence = seconds_from(n.number_or("silence_s", 3, {.min = 0.05, .max = 3600}));
  r.ready = seconds_from(n.number_or("ready_s", 5, {.min = 0.1, .max = 600}));
  r.log = n.text_or("log", "");
  s.frame_id = n.text_or("frame_id", config.name.substr(0, config.name.find('.')));
  s.buffers = static_cast<std::size_t>(n.integer_or("buffers", 16, {.min = 3, .max = 1000}));
  return s;
}

EmulatorSettings read_emulator_settings(const ConfigNode& n) {
  EmulatorSettings s;
  s.as = n.choice_or("as", {"pty", "tcp"}, "pty") == "pty" ? EmulatorSettings::As::pty
                                                           : EmulatorSettings::As::tcp;
  if (s.as == EmulatorSettings::As::pty) {
    s.link = n.text_or("link", "");
  } else {
    s.address = n.text_or("address", s.address);
    in6_addr parsed{};
    if (inet_pton(AF_INET, s.address.c_str(), &parsed) != 1 &&
        inet_pton(AF_INET6, s.address.c_str(), &parsed) != 1)
      throw n.error("address", "expected an IPv4 or IPv6 address of this machine, got \"" + s.address + "\"");
    s.port = static_cast<std::uint16_t>(n.integer_or("port", s.port, {.min = 0, .max = 65535}));
  }
  s.period = read_rate_or(n, "rate_hz", s.period, {.min = 0.1, .max = 1000});
  s.generation = static_cast<unsigned>(n.integer_or("generation", 9, {.min = 8, .max = 9}));
  const std::string speaks = n.choice_or("speaks", {"ubx", "nmea", "both"}, "ubx");
  std::vector<std::string> usual;
  const auto add = [&](std::initializer_list<const char*> names) {
    usual.insert(usual.end(), names.begin(), names.end());
  };
  if (speaks != "nmea") add({"pvt", "dop", "sat"});
  if (speaks != "nmea" && s.generation == 9) add({"cov", "hpposllh"});
  if (speaks != "nmea") add({"timegps", "eoe", "tim_tp"});
  if (speaks != "ubx") add({"rmc", "vtg", "gga", "gsa", "gsv", "gll", "gst", "zda"});
  s.messages = read_messages(n, usual);
  s.high_precision = n.flag_or("high_precision", false);
  const auto baud = n.integer_or("baud", s.baud, {.min = 1, .max = 4e6});
  if (!serial::is_standard_baud(static_cast<unsigned>(baud)))
    throw n.error("baud", "expected one of " + serial::standard_bauds() + ", got " + std::to_string(baud));
  s.baud = static_cast<unsigned>(baud);
  s.processing = seconds_from(n.number_or("processing_ms", 20, {.min = 0, .max = 2000}) * 1e-3);
  s.geoid_separation_m = n.number_or("geoid_separation_m", 0, {.min = -200, .max = 200});
  s.velocity_sigma_mps = n.number_or("velocity_sigma_mps", s.velocity_sigma_mps, {.min = 0, .max = 100});
  s.leap_seconds = static_cast<int>(n.integer_or("leap_seconds", 18, {.min = 0, .max = 60}));
  s.week_rollovers = n.integer_or("week_rollovers", 0, {.min = 0, .max = 2});
  s.corrections_timeout = seconds_from(n.number_or("corrections_timeout_s", 0, {.min = 0, .max = 3600}));
  return s;
}

}  // namespace rigor::gnss
