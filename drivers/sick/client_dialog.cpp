#include "drivers/sick/client_dialog.h"

#include <cmath>
#include <cstdio>

#include "drivers/sick/wire.h"
#include "rt-core/byte_order.h"
#include "rt-core/device_text.h"

namespace rigor::sick {
namespace {

constexpr std::uint32_t kClientHash = 0xF4724744, kSafetyClientHash = 0x6FD62C05;

std::string number(double v) {
  char text[32];
  std::snprintf(text, sizeof text, "%.4g", v);
  return text;
}
std::int32_t e4(double deg) { return static_cast<std::int32_t>(std::lround(deg * 1e4)); }
bool same_frequency(double a, double b) { return std::abs(a - b) <= 0.006 + 0.002 * b; }
/// People think in azimuths from straight ahead.
std::string azimuth(double device_deg) { return number(device_deg - kAheadDeg); }

}  // namespace

ClientDialog::ClientDialog(Wish wish) : wish_(std::move(wish)) {}

tl::unexpected<Error> ClientDialog::wrong(std::string message) const {
  return fail(ErrorCode::bad_input, wish_.where, std::move(message));
}

bool ClientDialog::wants_scan_config() const {
  // Without an answer to LMPscancfg nothing is set: the telegrams tell the frequency, and are checked.
  if (!facts_.scan_config_known) return false;
  if (wish_.scan_frequency_hz && !same_frequency(*wish_.scan_frequency_hz, facts_.scan_frequency_hz))
    return true;
  return wish_.resolution_deg && std::abs(step_deg(facts_.step_deg_e4) - *wish_.resolution_deg) > 2e-4;
}

bool ClientDialog::range_is_wanted() const {
  const std::int32_t slack = static_cast<std::int32_t>(facts_.step_deg_e4);
  return (!wish_.start_deg ||
          std::abs(static_cast<double>(facts_.start_deg_e4) - e4(*wish_.start_deg)) < slack) &&
         (!wish_.stop_deg || std::abs(static_cast<double>(facts_.stop_deg_e4) - e4(*wish_.stop_deg)) < slack);
}

ClientDialog::Step ClientDialog::after() const {
  switch (step_) {
    case Step::login:
    case Step::login_other:
      return Step::dialect;
    case Step::dialect:
      return Step::identity;
    case Step::identity:
      return Step::state;
    case Step::state:
      return Step::read_scan;
    case Step::read_scan:
      return wants_scan_config() ? Step::set_scan : Step::read_range;
    case Step::set_scan:
      return Step::read_range;
    case Step::read_range:
      if (facts_.range_known && !range_is_wanted()) return Step::write_range;
      [[fallthrough]];
    case Step::check_range:
      return wish_.echoes ? Step::echo_filter : Step::write_data;
    case Step::write_range:
      return Step::check_range;
    case Step::echo_filter:
      return Step::write_data;
    case Step::write_data:
      return Step::check_data;
    case Step::check_data:
      return Step::ready;
    case Step::start_measurement:
      return Step::run;
    case Step::run:
      return Step::subscribe;
    case Step::subscribe:
      return Step::streaming;
    case Step::ready:
    case Step::streaming:
      break;
  }
  return step_;
}

ClientDialog::Expected ClientDialog::expected() const {
  switch (step_) {
    case Step::login:
    case Step::login_other:
      return {"sAN", "SetAccessMode"};
    case Step::dialect:
      return {"sWA", "EIHstCola"};
    case Step::identity:
      return {"sRA", "DeviceIdent"};
    case Step::state:
      return {"sRA", "SCdevicestate"};
    case Step::read_scan:
      return {"sRA", "LMPscancfg"};
    case Step::set_scan:
      return {"sAN", "mLMPsetscancfg"};
    case Step::read_range:
    case Step::check_range:
      return {"sRA", "LMPoutputRange"};
    case Step::write_range:
      return {"sWA", "LMPoutputRange"};
    case Step::echo_filter:
      return {"sWA", "FREchoFilter"};
    case Step::write_data:
      return {"sWA", "LMDscandatacfg"};
    case Step::check_data:
      return {"sRA", "LMDscandatacfg"};
    case Step::start_measurement:
      return {"sAN", "LMCstartmeas"};
    case Step::run:
      return {"sAN", "Run"};
    case Step::subscribe:
      return {"sEA", "LMDscandata"};
    case Step::ready:
    case Step::streaming:
      break;
  }
  return {};
}

std::string_view ClientDialog::request_type() const {
  const auto type = expected().type;
  return type == "sAN" ? "sMN" : type == "sWA" ? "sWN" : type == "sEA" ? "sEN" : "sRN";
}

std::vector<std::uint8_t> ClientDialog::data_config() const {
  const bool tim = facts_.name.find("TiM") != std::string::npos;
  const bool wide = wish_.rssi == Rssi::bits16 || (wish_.rssi == Rssi::device && tim);
  const std::uint8_t echoes = wish_.echoes == EchoFilter::all ? 0x1F : 0x01;
  Buffer v;
  v.insert(v.end(),
           {echoes, 0, std::uint8_t{wish_.rssi != Rssi::off}, std::uint8_t{wide}, 0, 0, 0, 0, 0, 0, 1});
  append_be<std::uint16_t>(v, wish_.output_interval);
  return v;
}

void ClientDialog::values(Buffer& v) const {
  switch (step_) {
    case Step::login:
    case Step::login_other:
      append_be<std::uint8_t>(v, wish_.level);
      append_be<std::uint32_t>(
          v, wish_.password_hash.value_or(step_ == Step::login ? kClientHash : kSafetyClientHash));
      break;
    case Step::dialect:
    case Step::subscribe:
      append_be<std::uint8_t>(v, 1);
      break;
    case Step::set_scan:
      append_be(v, static_cast<std::uint32_t>(
                       std::lround(wish_.scan_frequency_hz.value_or(facts_.scan_frequency_hz) * 100)));
      append_be<std::uint16_t>(v, 1);
      append_be<std::uint32_t>(v, wish_.resolution_deg ? static_cast<std::uint32_t>(e4(*wish_.resolution_deg))
                                                       : facts_.step_deg_e4);
      append_be<std::int32_t>(v, facts_.start_deg_e4);
      append_be<std::int32_t>(v, facts_.stop_deg_e4);
      break;
    case Step::write_range:
      append_be<std::uint16_t>(v, 1);
      append_be<std::uint32_t>(v, facts_.step_deg_e4);
      append_be<std::int32_t>(v, wish_.start_deg ? e4(*wish_.start_deg) : facts_.start_deg_e4);
      append_be<std::int32_t>(v, wish_.stop_deg ? e4(*wish_.stop_deg) : facts_.stop_deg_e4);
      break;
    case Step::echo_filter:
      append_be(v, static_cast<std::uint8_t>(*wish_.echoes));
      break;
    case Step::write_data: {
      const auto config = data_config();
      v.insert(v.end(), config.begin(), config.end());
      break;
    }
    default:
      break;
  }
}

void ClientDialog::request(Buffer& out) const {
  Buffer v;
  values(v);
  append_telegram(out, request_type(), expected().name, v);
}

void ClientDialog::end_stream(Buffer& out) {
  const std::uint8_t off = 0;
  append_telegram(out, "sEN", "LMDscandata", Bytes(&off, 1));
}

Result<bool> ClientDialog::answer(const Telegram& t) {
  if (done()) return false;
  if (t.error()) {
    const Step before = step_;
    if (auto s = refused(t); !s) return tl::unexpected<Error>(s.error());
    if (step_ == before) step_ = after();
    return true;
  }
  const Expected e = expected();
  if (!t.is(e.type, e.name)) return false;
  const Step before = step_;
  if (auto s = take(t); !s) return tl::unexpected<Error>(s.error());
  if (step_ == before) step_ = after();
  return true;
}

/// An error of the device: what a client can do without is done without.
Status ClientDialog::refused(const Telegram& t) {
  if (step_ == Step::login && !wish_.password_hash) {
    step_ = Step::login_other;
    return {};
  }
  const bool optional = step_ == Step::dialect || step_ == Step::identity || step_ == Step::state ||
                        step_ == Step::read_scan ||
                        (step_ == Step::read_range && !wish_.start_deg && !wish_.stop_deg);
  if (optional) return {};
  const auto code = t.error_code();
  std::string message = "expected the device to take " + std::string(request_type()) + " " +
                        std::string(expected().name) + ", got its error " + std::to_string(code);
  if (const auto name = sopas_error_name(code); !name.empty()) message += " (" + std::string(name) + ")";
  if (step_ == Step::echo_filter) message += "; leave `echoes` out for devices that tell one echo";
  if (step_ == Step::write_range || step_ == Step::read_range)
    message += "; check `start_deg` and `stop_deg` against what the device offers";
  if (code == 1 || code == 10) message += "; check `password_hash`";
  return wrong(std::move(message));
}

Status ClientDialog::take(const Telegram& t) {
  WireReader r(t.values);
  const auto short_answer = [&] {
    return fail(ErrorCode::protocol, wish_.where,
                "expected a whole answer to " + std::string(expected().name) + ", got " +
                    std::to_string(t.values.size()) +
                    " bytes; check that this is a SICK LMS1xx, LMS5xx or TiM");
  };
  switch (step_) {
    case Step::login:
    case Step::login_other: {
      const auto taken = r.u8();
      if (!r.good()) return short_answer();
      if (taken == 1) return {};
      if (step_ == Step::login && !wish_.password_hash) {
        step_ = Step::login_other;
        return {};
      }
      return wrong("expected the device to let us in as level " + std::to_string(wish_.level) +
                   ", got a refusal; check `password_hash`");
    }
    case Step::identity:
      facts_.name = device_text(r.text(r.u16()));
      facts_.firmware = device_text(r.text(r.u16()));
      if (!r.good()) return short_answer();
      while (!facts_.firmware.empty() && facts_.firmware.back() == ' ') facts_.firmware.pop_back();
      return {};
    case Step::read_scan:
      facts_.scan_frequency_hz = r.u32() * 0.01;
      (void)r.u16();
      facts_.step_deg_e4 = r.u32();
      facts_.start_deg_e4 = r.i32();
      facts_.stop_deg_e4 = r.i32();
      if (!r.good()) return short_answer();
      facts_.scan_config_known = true;
      return {};
    case Step::set_scan: {
      const auto status = r.u8();
      const double frequency = r.u32() * 0.01;
      (void)r.u16();
      const auto step = r.u32();
      if (!r.good()) return short_answer();
      const double wanted_hz = wish_.scan_frequency_hz.value_or(facts_.scan_frequency_hz);
      const double wanted_deg = wish_.resolution_deg.value_or(step_deg(facts_.step_deg_e4));
      if (status != 0 || !same_frequency(wanted_hz, frequency) ||
          std::abs(step_deg(step) - wanted_deg) > 2e-4) {
        const char* why = status == 1   ? "this frequency"
                          : status == 2 ? "this resolution"
                          : status == 3 ? "this resolution over this angle"
                          : status == 4 ? "this angle"
                                        : "this";
        return wrong(
            "expected a device that scans at " + number(wanted_hz) + " Hz by " + number(wanted_deg) +
            " degree, got one that does not offer " + why + " and scans at " + number(frequency) + " Hz by " +
            number(step_deg(step)) +
            " degree; set `rate_hz`, `output_interval` and `resolution_deg` to what its manual lists");
      }
      facts_.scan_frequency_hz = frequency;
      facts_.step_deg_e4 = step;
      return {};
    }
    case Step::read_range:
    case Step::check_range: {
      (void)r.u16();
      facts_.step_deg_e4 = r.u32();
      facts_.start_deg_e4 = r.i32();
      facts_.stop_deg_e4 = r.i32();
      if (!r.good() || facts_.step_deg_e4 == 0 || facts_.stop_deg_e4 < facts_.start_deg_e4)
        return short_answer();
      facts_.range_known = true;
      if (step_ == Step::check_range && !range_is_wanted())
        return wrong("expected an output range from " +
                     azimuth(wish_.start_deg.value_or(facts_.start_deg_e4 * 1e-4)) + " to " +
                     azimuth(wish_.stop_deg.value_or(facts_.stop_deg_e4 * 1e-4)) +
                     " degrees, the device kept " + azimuth(facts_.start_deg_e4 * 1e-4) + " to " +
                     azimuth(facts_.stop_deg_e4 * 1e-4));
      return {};
    }
    case Step::check_data: {
      const auto wanted = data_config();
      // Echoes beyond those it has, a device leaves out; it must say the rest as it was told.
      const bool same = t.values.size() >= wanted.size() &&
                        std::equal(wanted.begin() + 2, wanted.end(), t.values.begin() + 2);
      if (!same)
        return wrong(
            "expected the device to keep `LMDscandatacfg` as written, got another; check `rssi` and "
            "`output_interval` against what it offers");
      facts_.echoes = 0;
      for (unsigned e = 0; e < kMaxEchoes; ++e) facts_.echoes += t.values[0] >> e & 1;
      facts_.echoes = std::max(facts_.echoes, 1u);
      return {};
    }
    case Step::start_measurement: {
      const auto status = r.u8();
      if (!r.good()) return short_answer();
      if (status != 0)
        return fail(ErrorCode::unavailable, wish_.where,
                    "expected the device to start measuring, got its refusal; look at its own error display");
      return {};
    }
    case Step::run:
    case Step::subscribe: {
      const auto done = r.u8();
      if (!r.good()) return short_answer();
      if (done != 1)
        return fail(ErrorCode::protocol, wish_.where,
                    "expected the device to " + std::string(step_ == Step::run ? "run" : "send its scans") +
                        ", got a refusal");
      return {};
    }
    default:
      return {};
  }
}

std::size_t ClientDialog::max_points() const {
  std::size_t beams = 65535;
  if (facts_.range_known && facts_.step_deg_e4 > 0) {
    // What a device says of its range need not make sense.
    const double span_deg = (static_cast<double>(facts_.stop_deg_e4) - facts_.start_deg_e4) * 1e-4;
    beams = static_cast<std::size_t>(
                std::clamp(std::ceil(span_deg / step_deg(facts_.step_deg_e4)), 0.0, 65533.0)) +
            2;
  }
  return std::min<std::size_t>(beams, 65535) * facts_.echoes;
}

}  // namespace rigor::sick
