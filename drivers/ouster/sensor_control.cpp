#include "drivers/ouster/sensor_control.h"

#include <arpa/inet.h>

#include <algorithm>
#include <cmath>
#include <optional>
#include <sstream>
#include <vector>

#include "drivers/ouster/bounded_json.h"

namespace rigor::ouster {
namespace {

using nlohmann::json;

/// A parameter of the configuration: its factory value, and what else it may be.
struct Parameter {
  enum class Kind : std::uint8_t { address, whole, number, flag, choice, window, mode, profile };
  const char* key;
  Kind kind;
  json factory;
  double min = 0, max = 0;
  std::vector<std::string> choices;
};

const std::vector<Parameter>& parameters() {
  using K = Parameter::Kind;
  static const std::vector<std::string> kPolarity{"ACTIVE_HIGH", "ACTIVE_LOW"};
  static const std::vector<Parameter> all{
      {"udp_dest", K::address, "127.0.0.1", 0, 0, {}},
      {"udp_port_lidar", K::whole, kLidarPort, 0, 65535, {}},
      {"udp_port_imu", K::whole, kImuPort, 0, 65535, {}},
      {"udp_profile_lidar", K::profile, std::string(name_of(Profile::single)), 0, 0, {}},
      {"udp_profile_imu", K::choice, "LEGACY", 0, 0, {"LEGACY"}},
      {"columns_per_packet", K::whole, 16, 16, 16, {}},
      {"lidar_mode", K::mode, "1024x10", 0, 0, {}},
      {"operating_mode", K::choice, "NORMAL", 0, 0, {"NORMAL", "STANDBY"}},
      {"azimuth_window", K::window, json::array({0, 360000}), 0, 360000, {}},
      {"timestamp_mode",
       K::choice,
       "TIME_FROM_INTERNAL_OSC",
       0,
       0,
       {"TIME_FROM_INTERNAL_OSC", "TIME_FROM_PTP_1588", "TIME_FROM_SYNC_PULSE_IN"}},
      {"multipurpose_io_mode",
       K::choice,
       "OFF",
       0,
       0,
       {"OFF", "INPUT_NMEA_UART", "OUTPUT_FROM_INTERNAL_OSC", "OUTPUT_FROM_SYNC_PULSE_IN",
        "OUTPUT_FROM_PTP_1588", "OUTPUT_FROM_ENCODER_ANGLE"}},
      {"sync_pulse_in_polarity", K::choice, "ACTIVE_HIGH", 0, 0, kPolarity},
      {"sync_pulse_out_polarity", K::choice, "ACTIVE_HIGH", 0, 0, kPolarity},
      {"sync_pulse_out_frequency", K::whole, 1, 1, 1000, {}},
      {"sync_pulse_out_angle", K::whole, 360, 0, 360, {}},
      {"sync_pulse_out_pulse_width", K::whole, 10, 0, 1000, {}},
      {"nmea_in_polarity", K::choice, "ACTIVE_HIGH", 0, 0, kPolarity},
      {"nmea_baud_rate", K::choice, "BAUD_9600", 0, 0, {"BAUD_9600", "BAUD_115200"}},
      {"nmea_ignore_valid_char", K::whole, 0, 0, 1, {}},
      {"nmea_leap_seconds", K::whole, 0, 0, 100, {}},
      {"phase_lock_enable", K::flag, false, 0, 0, {}},
      {"phase_lock_offset", K::whole, 0, 0, 360000, {}},
      {"signal_multiplier", K::number, 1, 0.25, 3, {}},
  };
  return all;
}

/// What is no UTF-8 becomes U+FFFD: clients may send anything.
std::string shown(const json& v) { return v.dump(-1, ' ', true, json::error_handler_t::replace); }

std::string bound(double v) { return v == std::round(v) ? std::to_string(std::lround(v)) : shown(v); }

/// The value as the sensor keeps it; `why`: what was expected where it cannot be.
std::optional<json> checked(const Parameter& p, json v, const SensorDevice& device, std::string& why) {
  using K = Parameter::Kind;
  // The commands have text for everything.
  if (v.is_string() &&
      (p.kind == K::whole || p.kind == K::number || p.kind == K::flag || p.kind == K::window)) {
    const json parsed = parse_bounded(v.get<std::string>());
    if (!parsed.is_discarded()) v = parsed;
  }
  if (p.kind == K::flag && v.is_number_integer() && (v == 0 || v == 1)) v = v == 1;
  switch (p.kind) {
    case K::address: {
      in_addr address{};
      why = "an IPv4 address";
      // A NUL would hide what follows it.
      if (!v.is_string() || v.get_ref<const std::string&>().find('\0') != std::string::npos ||
          inet_pton(AF_INET, v.get_ref<const std::string&>().c_str(), &address) != 1)
        return {};
      return v;
    }
    case K::whole:
    case K::number:
      why = (p.kind == K::whole ? "a whole number from " : "a number from ") + bound(p.min) + " to " +
            bound(p.max);
      if (p.kind == K::whole ? !v.is_number_integer() : !v.is_number()) return {};
      return v.get<double>() >= p.min && v.get<double>() <= p.max ? std::optional(v) : std::nullopt;
    case K::flag:
      why = "true or false";
      return v.is_boolean() ? std::optional(v) : std::nullopt;
    case K::choice:
      why = "one of";
      for (const std::string& c : p.choices) why += " " + c;
      return v.is_string() && std::count(p.choices.begin(), p.choices.end(), v.get<std::string>()) == 1
                 ? std::optional(v)
                 : std::nullopt;
    case K::window:
      why = "[first, last] in thousandths of a degree";
      if (!v.is_array() || v.size() != 2) return {};
      for (const json& e : v)
        if (!e.is_number_integer() || e.get<double>() < p.min || e.get<double>() > p.max) return {};
      return v;
    case K::mode: {
      const auto named = v.is_string() ? mode_named(v.get<std::string>()) : std::nullopt;
      why = name_of(device.scan_mode()) +
            ", or fewer columns at that rate: the simulated sensor measures no others";
      return named && device.offers(*named) ? std::optional(v) : std::nullopt;
    }
    case K::profile:
      why = "one of";
      for (const Profile profile : kProfiles) why += " " + std::string(name_of(profile));
      return v.is_string() && profile_named(v.get<std::string>()) ? std::optional(v) : std::nullopt;
  }
  return {};
}

/// Empty, or what parameters, each of which may be as it is, are not together.
std::string conflict_in(const json& c, const SensorDevice& device) {
  if (c["phase_lock_enable"] == true && c["timestamp_mode"] == "TIME_FROM_INTERNAL_OSC")
    return "phase_lock_enable: expected timestamp_mode TIME_FROM_PTP_1588 or TIME_FROM_SYNC_PULSE_IN with "
           "it: "
           "the sensor's own oscillator knows no full second; got TIME_FROM_INTERNAL_OSC";
  const std::string io = c["multipurpose_io_mode"];
  if (io.rfind("OUTPUT_", 0) != 0) return {};
  const double width_ms = c["sync_pulse_out_pulse_width"];
  double period_ms = 1e3 / c["sync_pulse_out_frequency"].get<double>();
  if (io == "OUTPUT_FROM_ENCODER_ANGLE")
    period_ms = c["sync_pulse_out_angle"].get<double>() / 360 * 1e3 / device.scan_mode().rate_hz;
  if (width_ms < period_ms) return {};
  return "sync_pulse_out_pulse_width: expected pulses that end before the next one begins, got pulses of " +
         bound(width_ms) + " ms every " + bound(period_ms) + " ms";
}

std::string decoded(std::string_view t) {
  const auto digit = [](char c) {
    return c >= '0' && c <= '9'   ? c - '0'
           : c >= 'a' && c <= 'f' ? c - 'a' + 10
           : c >= 'A' && c <= 'F' ? c - 'A' + 10
                                  : -1;
  };
  std::string out;
  for (std::size_t i = 0; i < t.size(); ++i) {
    if (t[i] == '+') {
      out += ' ';
    } else if (t[i] == '%' && i + 2 < t.size() && digit(t[i + 1]) >= 0 && digit(t[i + 2]) >= 0) {
      out += static_cast<char>(digit(t[i + 1]) * 16 + digit(t[i + 2]));
      i += 2;
    } else {
      out += t[i];
    }
  }
  return out;
}

/// Azimuths in the sensor's frame, anticlockwise from the first to the last. Measurement ids count clockwise,
/// and the middle of a turn looks forward.
ColumnWindow window_of(const json& mdeg, std::uint32_t columns) {
  const double first = mdeg[0].get<double>(), last = mdeg[1].get<double>();
  if (first == 0 && last == 360000) return {0, columns - 1};
  const auto column = [&](double v) {
    return static_cast<std::uint32_t>(std::lround((540000 - v) / 360000 * columns)) % columns;
  };
  return {column(last), (column(first) + columns - 1) % columns};
}

json transform_json(const std::array<double, 16>& t) {
  json out = json::array();
  for (std::size_t i = 0; i < 16; ++i) out.push_back(i % 4 == 3 && i < 12 ? t[i] * 1e3 : t[i]);
  return out;
}

}  // namespace

struct SensorControl::Impl {
  const SensorDevice* device = nullptr;
  Identity identity;
  json staged, current;
  std::uint32_t initialization_id = 0x520000;
  Active active;

  /// Empty, or what is wrong; then nothing has changed.
  [[nodiscard]] std::string set(const std::string& key, const json& value);
  [[nodiscard]] std::string activate(MonotonicTime now);
  [[nodiscard]] std::string status(MonotonicTime now) const {
    return now < active.ready ? "INITIALIZING" : active.standby ? "STANDBY" : "RUNNING";
  }
  [[nodiscard]] json group(std::string_view name, MonotonicTime now) const;
  [[nodiscard]] json metadata(MonotonicTime now) const;
  /// The answer of a command; empty: there is none of that name. `error`: it failed.
  [[nodiscard]] std::optional<json> command(const std::string& name, const std::string& arguments,
                                            std::string_view client, MonotonicTime now, std::string& error);
};

std::string SensorControl::Impl::set(const std::string& key, const json& value) {
  if (key == ".") {
    const json all = value.is_string() ? parse_bounded(value.get<std::string>()) : value;
    if (!all.is_object()) return "expected a map of parameters";
    const json before = staged;
    for (const auto& [k, v] : all.items())
      if (std::string wrong = k == "." ? "expected no map within the map" : set(k, v); !wrong.empty()) {
        staged = before;
        return wrong;
      }
    return {};
  }
  for (const Parameter& p : parameters()) {
    if (key != p.key) continue;
    std::string why;
    const auto v = checked(p, value, *device, why);
    if (!v) return key + ": expected " + why + ", got " + shown(value);
    staged[key] = *v;
    return {};
  }
  return key + ": expected a parameter of the sensor's configuration, got an unknown one";
}

std::string SensorControl::Impl::activate(MonotonicTime now) {
  if (std::string wrong = conflict_in(staged, *device); !wrong.empty()) return wrong;
  current = staged;
  const auto mode = mode_named(current["lidar_mode"].get<std::string>()).value_or(device->scan_mode());
  DeviceMode m{profile_named(current["udp_profile_lidar"].get<std::string>()).value_or(Profile::single), mode,
               window_of(current["azimuth_window"], mode.columns)};
  active.metadata = device->metadata(m);
  active.metadata.product_line = identity.product_line;
  active.metadata.serial = identity.serial;
  active.metadata.firmware = identity.firmware;
  active.metadata.timestamp_mode = current["timestamp_mode"].get<std::string>();
  active.metadata.lidar_port = current["udp_port_lidar"].get<std::uint16_t>();
  active.metadata.imu_port = current["udp_port_imu"].get<std::uint16_t>();
  active.metadata.initialization_id = ++initialization_id & 0xFFFFFF;
  active.udp_dest = current["udp_dest"].get<std::string>();
  active.standby = current["operating_mode"] == "STANDBY";
  using Mode = SensorTime::Mode;
  active.time.mode = active.metadata.timestamp_mode == "TIME_FROM_PTP_1588"        ? Mode::ptp
                     : active.metadata.timestamp_mode == "TIME_FROM_SYNC_PULSE_IN" ? Mode::sync_pulse
                                                                                   : Mode::internal;
  active.time.nmea = current["multipurpose_io_mode"] == "INPUT_NMEA_UART";
  active.time.nmea_leap = seconds(current["nmea_leap_seconds"].get<std::int64_t>());
  active.time.phase_lock = current["phase_lock_enable"].get<bool>();
  active.time.phase_lock_deg = current["phase_lock_offset"].get<double>() * 1e-3;
  ++active.generation;
  active.ready = now + identity.start_up;
  return {};
}

json SensorControl::Impl::group(std::string_view name, MonotonicTime now) const {
  const Metadata& m = active.metadata;
  if (name == "sensor_info")
    return {{"prod_line", m.product_line},
            {"prod_sn", m.serial},
            {"prod_pn", "840-000000-00"},
            {"build_rev", m.firmware},
            {"image_rev", "ousteros-image-prod-aries-" + m.firmware + "+emulated"},
            {"build_date", "2024-01-01T00:00:00Z"},
            {"initialization_id", m.initialization_id},
            {"status", status(now)}};
  if (name == "beam_intrinsics")
    return {
        {"beam_altitude_angles", m.beam_altitude_deg},
        {"beam_azimuth_angles", m.beam_azimuth_deg},
        {"lidar_origin_to_beam_origin_mm", m.beam_origin_m * 1e3},
        {"beam_to_lidar_transform", {1, 0, 0, m.beam_origin_m * 1e3, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1}}};
  if (name == "imu_intrinsics") return {{"imu_to_sensor_transform", transform_json(m.T_sensor_imu)}};
  if (name == "lidar_intrinsics") return {{"lidar_to_sensor_transform", transform_json(m.T_sensor_lidar)}};
  if (name == "lidar_data_format")
    return {{"columns_per_frame", m.mode.columns},
            {"columns_per_packet", m.columns_per_packet},
            {"column_window", {m.window.first, m.window.last}},
            {"pixels_per_column", m.pixels_per_column},
            {"pixel_shift_by_row", m.pixel_shift},
            {"udp_profile_lidar", std::string(name_of(m.profile))},
            {"udp_profile_imu", "LEGACY"},
            {"fps", m.mode.rate_hz}};
  if (name == "calibration_status")
    return {{"reflectivity", {{"valid", true}, {"timestamp", "2024-01-01T00:00:00"}}}};
  return nullptr;
}

json SensorControl::Impl::metadata(MonotonicTime now) const {
  json all{{"config_params", current}, {"user_data", ""}};
  for (const char* name : {"sensor_info", "beam_intrinsics", "imu_intrinsics", "lidar_intrinsics",
                           "lidar_data_format", "calibration_status"})
    all[name] = group(name, now);
  return all;
}

std::optional<json> SensorControl::Impl::command(const std::string& name, const std::string& arguments,
                                                 std::string_view client, MonotonicTime now,
                                                 std::string& error) {
  if (name == "get_config_param") {
    std::istringstream words(arguments);
    std::string which, key;
    words >> which >> key;
    if (which != "active" && which != "staged") {
      error = "expected active or staged";
      return json();
    }
    const json& from = which == "active" ? current : staged;
    if (key.empty()) return from;
    if (from.contains(key)) return from[key];
    error = key + ": no such parameter";
    return json();
  }
  if (name == "set_config_param") {
    const std::size_t space = arguments.find(' ');
    error = set(arguments.substr(0, space),
                space == std::string::npos ? json("") : json(arguments.substr(space + 1)));
    return json(name);
  }
  if (name == "set_udp_dest_auto") {
    error = set("udp_dest", std::string(client));
    return json::object();
  }
  if (name == "reinitialize") {
    error = activate(now);
    return json::object();
  }
  if (name == "save_config_params" || name == "write_config_txt") return json::object();
  if (name.rfind("get_", 0) == 0)
    if (json g = group(std::string_view(name).substr(4), now); !g.is_null()) return g;
  return {};
}

SensorControl::SensorControl(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
SensorControl::SensorControl(SensorControl&&) noexcept = default;
SensorControl& SensorControl::operator=(SensorControl&&) noexcept = default;
SensorControl::~SensorControl() = default;

Result<SensorControl> SensorControl::create(const SensorDevice& device, Identity identity,
                                            std::string_view config, MonotonicTime now) {
  auto impl = std::make_unique<Impl>();
  impl->device = &device;
  impl->identity = std::move(identity);
  impl->staged = json::object();
  for (const Parameter& p : parameters()) impl->staged[p.key] = p.factory;
  impl->staged["lidar_mode"] = name_of(device.scan_mode());
  const json given = parse_bounded(config.empty() ? "{}" : config);
  if (given.is_discarded()) return fail(ErrorCode::bad_input, "config", "expected a map of parameters");
  if (const std::string wrong = impl->set(".", given); !wrong.empty())
    return fail(ErrorCode::bad_input, "config", wrong);
  if (const std::string wrong = impl->activate(now); !wrong.empty())
    return fail(ErrorCode::bad_input, "config", wrong);
  return SensorControl(std::move(impl));
}

SensorControl::Reply SensorControl::http(std::string_view method, std::string_view target,
                                         std::string_view body, std::string_view client, MonotonicTime now) {
  const std::size_t question = target.find('?');
  const std::string_view path = target.substr(0, question);
  const auto refuse = [](int status, const std::string& why) {
    return Reply{status, shown(json{{"error", why}})};
  };
  const auto starts = [&](std::string_view with) { return path.substr(0, with.size()) == with; };
  constexpr std::string_view kMetadata = "/api/v1/sensor/metadata", kConfig = "/api/v1/sensor/config",
                             kCommand = "/api/v1/sensor/cmd/";
  const bool get = method == "GET";
  if (path == kConfig && method == "POST") {
    const json given = parse_bounded(body);
    if (!given.is_object()) return refuse(400, "expected a map of parameters");
    const json before = impl_->staged;
    std::string wrong = impl_->set(".", given);
    if (wrong.empty()) wrong = impl_->activate(now);
    if (wrong.empty()) return {200, "{}"};
    impl_->staged = before;
    return refuse(400, wrong);
  }
  if (!get) return refuse(405, "expected GET, or POST of /api/v1/sensor/config");
  if (path == kConfig) return {200, shown(impl_->current)};
  if (path == "/api/v1/system/firmware")
    return {200, shown(json{{"fw", "ousteros-image-prod-aries-" + impl_->identity.firmware + "+emulated"}})};
  if (path == kMetadata || path == "/api/v1/sensor/metadata/") return {200, shown(impl_->metadata(now))};
  if (starts(kMetadata) && path[kMetadata.size()] == '/')
    if (const json g = impl_->group(path.substr(kMetadata.size() + 1), now); !g.is_null())
      return {200, shown(g)};
  if (starts(kCommand)) {
    std::string arguments;
    if (question != std::string_view::npos) {
      const std::string_view query = target.substr(question + 1);
      if (query.substr(0, 5) == "args=") arguments = decoded(query.substr(5));
    }
    std::string error;
    const auto answer =
        impl_->command(std::string(path.substr(kCommand.size())), arguments, client, now, error);
    if (answer && !error.empty()) return refuse(400, error);
    if (answer) return {200, shown(*answer)};
  }
  return refuse(404, "expected a path of the sensor's interface below /api/v1");
}

std::string SensorControl::tcp(std::string_view line, std::string_view client, MonotonicTime now) {
  while (!line.empty() && (line.back() == ' ' || line.back() == '\r')) line.remove_suffix(1);
  const std::size_t space = line.find(' ');
  const std::string name(line.substr(0, space));
  const std::string arguments(space == std::string_view::npos ? std::string_view() : line.substr(space + 1));
  std::string error;
  const auto answer = impl_->command(name, arguments, client, now, error);
  if (!answer) return "error: unknown command " + name;
  if (!error.empty()) return "error: " + error;
  // Over TCP what was done is answered with the command's name.
  return answer->is_object() && answer->empty() ? name
         : answer->is_string()                  ? answer->get<std::string>()
                                                : shown(*answer);
}

const SensorControl::Active& SensorControl::active() const { return impl_->active; }

}  // namespace rigor::ouster
