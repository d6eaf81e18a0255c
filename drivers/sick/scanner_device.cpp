#include "drivers/sick/scanner_device.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

#include "drivers/sick/wire.h"
#include "rt-core/byte_order.h"

namespace rigor::sick {
namespace {

constexpr std::int64_t kDayUs = 86'400'000'000;
constexpr std::uint8_t kWriters = 2;  // maintenance and above may write

/// What a device that was never told the date says: its start is 1970-01-01.
ScanTime date_of(DeviceTime t) {
  const std::int64_t us = std::max<std::int64_t>(0, t.ns() / 1000);
  ScanTime time;
  // Nothing here runs for a month: the day is enough of a calendar.
  time.day = static_cast<std::uint8_t>(1 + us / kDayUs % 28);
  const std::int64_t of_day = us % kDayUs;
  time.hour = static_cast<std::uint8_t>(of_day / 3'600'000'000);
  time.minute = static_cast<std::uint8_t>(of_day / 60'000'000 % 60);
  time.second = static_cast<std::uint8_t>(of_day / 1'000'000 % 60);
  time.microsecond = static_cast<std::uint32_t>(of_day % 1'000'000);
  return time;
}

std::int32_t deg_e4(double deg) { return static_cast<std::int32_t>(std::lround(deg * 1e4)); }

}  // namespace

ScannerConfig scanner_config(Family family) {
  ScannerConfig c;
  c.family = family;
  switch (family) {
    case Family::lms1xx:
      c.name = "LMS10x_FieldEval", c.firmware = "V1.36-21.10.2010";
      c.scan_frequency_hz = 50;
      break;
    case Family::lms5xx:
      c.name = "LMS511_FieldEval", c.firmware = "V1.80    ";
      c.scan_frequency_hz = 25, c.echoes = 5;
      c.distance_scale = 2;  // 80 m do not fit into 16 bits of millimetres
      break;
    case Family::tim:
      c.name = "TiM781S", c.firmware = "V3.13";
      c.scan_frequency_hz = 15, c.rssi_bits = 16;
      break;
  }
  return c;
}

Status check(const ScannerConfig& c) {
  const auto wrong = [](const std::string& message) {
    return fail(ErrorCode::bad_input, "SICK scanner", message);
  };
  if (!(c.scan_frequency_hz > 0 && c.scan_frequency_hz <= 1000))
    return wrong("expected a scan frequency above 0 and up to 1000 Hz");
  if (!(c.pattern.step_deg >= 0.001 && c.pattern.step_deg <= 6.5535))
    return wrong("expected an angular step of 0.001 to 6.5535 degrees");
  if (c.pattern.beams < 1 || c.pattern.beams > 65535) return wrong("expected 1 to 65535 beams");
  if (c.pattern.start_deg < c.zero_index_deg ||
      c.pattern.step_deg * (c.pattern.beams - 1) > 360 + c.zero_index_deg - c.pattern.start_deg)
    return wrong(
        "expected beams within one revolution from the zero index at -90 degrees of the device's count "
        "(straight behind)");
  if (c.name.size() > 255 || c.location.size() > 255 || c.firmware.size() > 255)
    return wrong("expected names of up to 255 bytes");
  return {};
}

ScannerDevice::ScannerDevice(ScannerConfig config)
    : config_(std::move(config)),
      period_(Duration(std::llround(1e9 / config_.scan_frequency_hz))),
      step_deg_e4_(static_cast<std::uint32_t>(std::lround(config_.pattern.step_deg * 1e4))),
      range_{deg_e4(config_.pattern.start_deg), deg_e4(config_.pattern.stop_deg())},
      measuring_(config_.started) {
  config_.echoes = std::clamp<std::uint32_t>(config_.echoes, 1, kMaxEchoes);
  data_.wide_rssi = config_.rssi_bits > 8;
}

DeviceTime ScannerDevice::first_beam(DeviceTime zero) const {
  const double degrees = config_.pattern.start_deg - config_.zero_index_deg;
  return zero + Duration(std::llround(degrees / 360 * static_cast<double>(period_.ns())));
}

DeviceTime ScannerDevice::transmission(DeviceTime zero) const {
  const ScanPattern p = plan().pattern;
  const double degrees = p.stop_deg() - config_.zero_index_deg;
  return zero + Duration(std::llround(degrees / 360 * static_cast<double>(period_.ns()))) +
         config_.processing;
}

ChannelPlan ScannerDevice::plan() const {
  ChannelPlan plan;
  plan.pattern.step_deg = step_deg(step_deg_e4_);
  const double first =
      std::ceil((range_.start_deg_e4 * 1e-4 - config_.pattern.start_deg) / plan.pattern.step_deg - 1e-3);
  const double last =
      std::floor((range_.stop_deg_e4 * 1e-4 - config_.pattern.start_deg) / plan.pattern.step_deg + 1e-3);
  plan.pattern.start_deg = config_.pattern.start_deg + first * plan.pattern.step_deg;
  plan.pattern.beams = static_cast<std::uint32_t>(std::max(0.0, last - first + 1));
  plan.filter = filter_;
  std::uint32_t echoes = 1;
  if (filter_ == EchoFilter::all)
    for (std::uint32_t e = 1; e < config_.echoes; ++e)
      if (data_.echo_mask & (1u << e)) echoes = e + 1;
  plan.echoes = echoes;
  plan.rssi = data_.rssi != 0;
  plan.rssi_16_bit = data_.wide_rssi != 0;
  plan.rssi_shift = config_.rssi_bits > 8 && !plan.rssi_16_bit ? config_.rssi_bits - 8 : 0;
  plan.distance_scale = config_.distance_scale;
  return plan;
}

void ScannerDevice::answer(Session& session, Bytes body, DeviceTime now, Buffer& out) {
  ++counters_.requests;
  const auto t = parse_telegram(body);
  SopasError error = SopasError::unknown_command;
  Buffer values;
  std::string_view type;
  if (!t || t->error()) {
    ++counters_.malformed;
  } else if (t->type == "sRN") {
    type = "sRA";
    error = read(t->name, now, values);
  } else if (t->type == "sWN") {
    type = "sWA";
    error = write(session, t->name, t->values);
  } else if (t->type == "sMN") {
    type = "sAN";
    error = method(session, t->name, t->values, values);
  } else if (t->type == "sEN") {
    type = "sEA";
    error = subscribe(session, t->name, t->values, values);
  }
  if (error != SopasError::ok) {
    ++counters_.refused;
    append_error(out, error);
    return;
  }
  append_telegram(out, type, t->name, values);
}

SopasError ScannerDevice::read(std::string_view name, DeviceTime now, Buffer& v) {
  if (name == "DeviceIdent") {
    append_string(v, config_.name);
    append_string(v, config_.firmware);
  } else if (name == "FirmwareVersion") {
    append_string(v, config_.firmware);
  } else if (name == "LocationName") {
    append_string(v, config_.location);
  } else if (name == "SerialNumber") {
    char text[16];
    append_string(
        v, {text, static_cast<std::size_t>(std::snprintf(text, sizeof text, "%08u", config_.serial_number))});
  } else if (name == "SCdevicestate") {
    append_be<std::uint8_t>(v, measuring_ ? 1 : 0);
  } else if (name == "ODoprh") {  // operating hours, in tenths
    append_be(v, static_cast<std::uint32_t>(now.ns() / 360'000'000'000));
  } else if (name == "ODpwrc") {  // how often it was switched on
    append_be<std::uint32_t>(v, 1);
  } else if (name == "LCMstate") {  // contamination of the window: none
    append_be<std::uint8_t>(v, 0);
  } else if (name == "STlms") {
    // Status (7: ready, measuring), temperature in range, time and date as text, three LEDs.
    const ScanTime d = date_of(now);
    char text[40];
    append_be<std::uint16_t>(v, measuring_ ? 7 : 1);
    append_be<std::uint8_t>(v, 0);
    append_string(v, {text, static_cast<std::size_t>(std::snprintf(text, sizeof text, "%02u:%02u:%02u",
                                                                   d.hour, d.minute, d.second))});
    append_string(v, {text, static_cast<std::size_t>(
                                std::snprintf(text, sizeof text, "%02u.%02u.%04u", d.day, d.month, d.year))});
    for (int led = 0; led < 3; ++led) append_be<std::uint8_t>(v, 0);
  } else if (name == "LMPscancfg") {
    put_scan_config(v);
  } else if (name == "LMPoutputRange") {
    append_be<std::uint16_t>(v, 1);
    append_be<std::uint32_t>(v, step_deg_e4_);
    append_be<std::int32_t>(v, range_.start_deg_e4);
    append_be<std::int32_t>(v, range_.stop_deg_e4);
  } else if (name == "FREchoFilter") {
    append_be(v, static_cast<std::uint8_t>(filter_));
  } else if (name == "LMDscandatacfg") {
    for (const auto b :
         {data_.echo_mask, data_.channels_high, data_.rssi, data_.wide_rssi, data_.unit, data_.encoder[0],
          data_.encoder[1], data_.position, data_.name, data_.comment, data_.time})
      append_be<std::uint8_t>(v, b);
    append_be<std::uint16_t>(v, data_.interval);
  } else if (name == "LIDinputstate") {
    v.assign(12, 0);  // as a TiM781S answers with nothing at its inputs
    v[6] = 1;
  } else if (name == "LMDscandata") {
    if (!have_scan_) return SopasError::local_condition_failed;
    encode_scan(scan_, v);
  } else {
    return SopasError::unknown_variable;
  }
  return SopasError::ok;
}

void ScannerDevice::put_scan_config(Buffer& out) const {
  append_be<std::uint32_t>(out, static_cast<std::uint32_t>(std::lround(config_.scan_frequency_hz * 100)));
  append_be<std::uint16_t>(out, 1);  // sectors
  append_be<std::uint32_t>(out, step_deg_e4_);
  append_be<std::int32_t>(out, deg_e4(config_.pattern.start_deg));
  append_be<std::int32_t>(out, deg_e4(config_.pattern.stop_deg()));
}

SopasError ScannerDevice::write(const Session& session, std::string_view name, Bytes values) {
  WireReader r(values);
  if (name == "EIHstCola") {  // the dialect: this one alone is spoken; anybody may ask for it
    const auto dialect = r.u8();
    if (!r.good()) return SopasError::buffer_underflow;
    return dialect == 1 ? SopasError::ok : SopasError::local_condition_failed;
  }
  const bool known = name == "LMDscandatacfg" || name == "LMPoutputRange" || name == "FREchoFilter" ||
                     name == "LocationName" || name == "LFPparticle" || name == "LFPmeanfilter" ||
                     name == "LMLpwrsave" || name == "LICencset" || name == "LICsrc" ||
                     name == "SetActiveApplications";
  if (!known) return SopasError::unknown_variable;
  if (session.level < kWriters) return SopasError::write_access_denied;
  if (name == "LMDscandatacfg") return set_data_config(values);
  if (name == "LMPoutputRange") return set_output_range(values);
  if (name == "FREchoFilter") {
    const auto f = r.u8();
    if (!r.good()) return SopasError::buffer_underflow;
    if (f > 2) return SopasError::local_condition_failed;
    filter_ = static_cast<EchoFilter>(f);
    return SopasError::ok;
  }
  if (name == "LocationName") {
    const auto text = r.text(r.u16());
    if (!r.good()) return SopasError::buffer_underflow;
    if (text.size() > 255) return SopasError::local_condition_failed;
    config_.location = text;
    return SopasError::ok;
  }
  // Filters, encoders and applications that this device does not have may be switched off.
  const auto on = r.u8();
  if (!r.good()) return SopasError::buffer_underflow;
  return on == 0 ? SopasError::ok : SopasError::local_condition_failed;
}

SopasError ScannerDevice::set_data_config(Bytes values) {
  WireReader r(values);
  DataConfig c;
  for (auto* b : {&c.echo_mask, &c.channels_high, &c.rssi, &c.wide_rssi, &c.unit, &c.encoder[0],
                  &c.encoder[1], &c.position, &c.name, &c.comment, &c.time})
    *b = r.u8();
  c.interval = r.u16();
  if (!r.good()) return SopasError::buffer_underflow;
  if (c.rssi > 1 || c.wide_rssi > 1 || c.unit != 0 || c.position > 1 || c.name > 1 || c.comment > 1 ||
      c.time > 1 || c.interval == 0)
    return SopasError::local_condition_failed;
  data_ = c;
  return SopasError::ok;
}

SopasError ScannerDevice::set_output_range(Bytes values) {
  WireReader r(values);
  const auto sectors = r.u16();
  const auto step = r.u32();
  const auto start = r.i32(), stop = r.i32();
  if (!r.good()) return SopasError::buffer_underflow;
  // The step is told along but not set here; clients that do not know it write 0 or their own rounding.
  if (step != 0 && std::abs(static_cast<std::int64_t>(step) - step_deg_e4_) > 1)
    return SopasError::local_condition_failed;
  const auto least = deg_e4(config_.pattern.start_deg), most = deg_e4(config_.pattern.stop_deg());
  if (sectors != 1 || start > stop || start < least || stop > most) return SopasError::local_condition_failed;
  const OutputRange before = range_;
  range_ = {start, stop};
  if (plan().pattern.beams == 0) {
    range_ = before;
    return SopasError::local_condition_failed;
  }
  return SopasError::ok;
}

SopasError ScannerDevice::set_scan_config(Bytes values, Buffer& answer) {
  WireReader r(values);
  const auto frequency = r.u32();
  const auto sectors = r.u16();
  const auto step = r.u32();
  if (!r.good()) return SopasError::buffer_underflow;
  // 0 set, 1 this frequency is not offered, 2 this step is not, 5 anything else. The angles are not looked
  // at: devices with one sector measure all they can.
  const bool same_frequency =
      std::abs(frequency * 0.01 - config_.scan_frequency_hz) < 0.006 + 0.001 * config_.scan_frequency_hz;
  const double wanted = step_deg(step);
  const double parts = wanted / config_.pattern.step_deg;
  const bool multiple = parts > 0.999 && std::abs(parts - std::round(parts)) < 2e-3 * parts;
  std::uint8_t status = 0;
  if (sectors != 1) {
    status = 5;
  } else if (!same_frequency) {
    status = 1;
  } else if (!multiple) {
    status = 2;
  } else {
    step_deg_e4_ =
        static_cast<std::uint32_t>(std::lround(std::round(parts) * config_.pattern.step_deg * 1e4));
    if (plan().pattern.beams == 0)
      range_ = {deg_e4(config_.pattern.start_deg), deg_e4(config_.pattern.stop_deg())};
  }
  append_be(answer, status);
  put_scan_config(answer);
  return SopasError::ok;
}

SopasError ScannerDevice::method(Session& session, std::string_view name, Bytes values, Buffer& answer) {
  WireReader r(values);
  if (name == "SetAccessMode") {
    const auto level = r.u8();
    const auto hash = r.u32();
    if (!r.good()) return SopasError::buffer_underflow;
    // Maintenance, authorised client (of most devices and of the TiM7xxS), service: SICK's own passwords.
    const bool right = (level == 2 && hash == 0xB21ACE26) ||
                       (level == 3 && (hash == 0xF4724744 || hash == 0x6FD62C05)) ||
                       (level == 4 && hash == 0x81BE23AA);
    if (right) session.level = level;
    append_be<std::uint8_t>(answer, right);
    return SopasError::ok;
  }
  if (name == "Run") {
    session.level = 0;
    append_be<std::uint8_t>(answer, 1);
    return SopasError::ok;
  }
  if (name == "LMCstartmeas" || name == "LMCstopmeas") {
    if (session.level < kWriters) return SopasError::method_access_denied;
    measuring_ = name == "LMCstartmeas";
    append_be<std::uint8_t>(answer, 0);
    return SopasError::ok;
  }
  if (name == "mLMPsetscancfg") {
    if (session.level < kWriters) return SopasError::method_access_denied;
    return set_scan_config(values, answer);
  }
  if (name == "mEEwriteall" || name == "LSPsetdatetime") {
    if (session.level < kWriters) return SopasError::method_access_denied;
    append_be<std::uint8_t>(answer, 1);
    return SopasError::ok;
  }
  return SopasError::unknown_method;
}

SopasError ScannerDevice::subscribe(Session& session, std::string_view name, Bytes values, Buffer& answer) {
  WireReader r(values);
  const auto on = r.u8();
  if (!r.good()) return SopasError::buffer_underflow;
  if (on > 1) return SopasError::local_condition_failed;
  // Fields and switching inputs and outputs never change here, so nothing is told of them.
  if (name != "LMDscandata" && name != "LFErec" && name != "LIDoutputstate" && name != "LIDinputstate")
    return SopasError::unknown_event;
  if (name == "LMDscandata") session.scans = on == 1;
  append_be<std::uint8_t>(answer, on);
  return SopasError::ok;
}

bool ScannerDevice::made_scan(std::uint64_t scan) { return scan % data_.interval == 0; }

void ScannerDevice::set_scan(std::span<const LidarPoint> points, std::uint64_t scan, DeviceTime zero,
                             DeviceTime transmission) {
  const ChannelPlan p = plan();
  counters_.astray_points += maker_.fill(points, p, scan_);
  scan_.serial_number = config_.serial_number;
  scan_.telegram_counter = ++telegram_counter_;
  scan_.scan_counter = static_cast<std::uint16_t>(scan + 1);
  scan_.time_since_startup_us = static_cast<std::uint32_t>(zero.ns() / 1000);
  scan_.time_of_transmission_us = static_cast<std::uint32_t>(transmission.ns() / 1000);
  scan_.scan_frequency_hz_e2 = static_cast<std::uint32_t>(std::lround(config_.scan_frequency_hz * 100));
  scan_.measurement_frequency_100hz =
      static_cast<std::uint32_t>(std::lround(360 / p.pattern.step_deg * config_.scan_frequency_hz / 100));
  scan_.name.reset();
  scan_.comment.reset();
  scan_.time.reset();
  scan_.position.reset();
  if (data_.name) scan_.name = config_.location;
  if (data_.comment) scan_.comment = "";
  if (data_.time) scan_.time = date_of(transmission);
  if (data_.position) scan_.position.emplace();
  have_scan_ = true;
}

void ScannerDevice::append_scan(Buffer& out) const {
  const auto begin = begin_frame(out);
  append_text(out, "sSN LMDscandata ");
  encode_scan(scan_, out);
  end_frame(out, begin);
}

}  // namespace rigor::sick
