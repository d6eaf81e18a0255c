#include "drivers/modbus/modbus_emulator.h"

#include "drivers/modbus/register_bank.h"

namespace rigor::modbus {
namespace {

ServerFaults parse_faults(const ConfigNode& n) {
  ServerFaults f;
  f.response_delay = seconds_from(n.number_or("response_delay_ms", 0, {.min = 0, .max = 60000}) * 1e-3);
  f.exception_every = static_cast<std::uint32_t>(n.integer_or("exception_every", 0, {.min = 0, .max = 1e9}));
  f.exception_code = static_cast<std::uint8_t>(n.integer_or("exception_code", 4, {.min = 1, .max = 11}));
  f.silent_every = static_cast<std::uint32_t>(n.integer_or("silent_every", 0, {.min = 0, .max = 1e9}));
  f.from = seconds_from(n.number_or("from_s", 0, {.min = 0, .max = 1e6}));
  f.duration = seconds_from(n.number_or("for_s", 0, {.min = 0, .max = 1e6}));
  n.finish();
  return f;
}

void parse_line(const ConfigNode& n, EmulatorSettings& s) {
  s.serial = parse_line_settings(n);
  const bool pty = n.has("pty"), device = n.has("device");
  if (pty == device)
    throw n.error(pty ? "device" : "pty",
                  "expected either `pty` (a path for a pseudo-terminal) or `device` (a serial port), got " +
                      std::string(pty ? "both" : "neither"));
  (pty ? s.pty : s.serial->device) = n.text(pty ? "pty" : "device");
  if ((pty ? s.pty : s.serial->device).empty())
    throw n.error(pty ? "pty" : "device", "expected a path, got \"\"");
  s.options.unit = static_cast<std::uint8_t>(n.integer_or("unit", 1, {.min = 1, .max = 247}));
}

}  // namespace

EmulatorSettings EmulatorSettings::parse(const ConfigNode& n) {
  EmulatorSettings s;
  if (n.choice_or("transport", {"tcp", "rtu"}, "tcp") == "rtu") {
    parse_line(n, s);
  } else {
    s.address = n.text_or("address", "127.0.0.1");
    s.port = static_cast<std::uint16_t>(n.integer_or("port", 502, {.min = 0, .max = 65535}));
    s.options.max_clients = static_cast<unsigned>(n.integer_or("max_clients", 8, {.min = 1, .max = 1000}));
    if (n.has("unit")) s.options.unit = static_cast<std::uint8_t>(n.integer("unit", {.min = 0, .max = 255}));
  }
  s.options.idle_limit = seconds_from(n.number_or("idle_limit_s", 60, {.min = 0, .max = 1e6}));
  s.faults = parse_faults(n.map_or_absent("faults"));
  if (n.has("registers")) {
    if (n.has("model"))
      throw n.error("registers", "expected `model` or `registers`, got both: a model has its own registers");
    s.registers = RegisterBank::parse(n);
  }
  return s;
}

ModbusEmulator::~ModbusEmulator() {
  if (state() == ChannelState::armed || state() == ChannelState::running) (void)stop();
}

void ModbusEmulator::attach(DeviceParts parts) { parts_ = std::move(parts); }

std::string ModbusEmulator::endpoint() const {
  if (settings_.serial)
    return "Modbus RTU device " + config().name + " unit " +
           std::to_string(settings_.options.unit.value_or(1)) + " at " + device();
  const bool six = settings_.address.find(':') != std::string::npos;
  return "Modbus TCP device " + config().name + " at " +
         (six ? "[" + settings_.address + "]" : settings_.address) + ":" + std::to_string(port());
}

std::uint16_t ModbusEmulator::port() const noexcept {
  return server_ && server_->port() != 0 ? server_->port() : settings_.port;
}

std::string ModbusEmulator::device() const {
  if (!settings_.serial) return {};
  return pty_ ? pty_->path() : settings_.pty.empty() ? settings_.serial->device : settings_.pty;
}

void ModbusEmulator::set_faults(const ServerFaults& faults) {
  if (server_) server_->faults().set(faults);
}

Status ModbusEmulator::do_configure(const ChannelConfig& config) {
  settings_ = EmulatorSettings::parse(config.params);
  description_.kind = SampleKind::register_block;
  description_.frame_id = config.name;
  return {};
}

Status ModbusEmulator::open_line() {
  if (settings_.pty.empty()) {
    auto port = serial::open_serial(*settings_.serial, serial::Sharing::exclusive);
    if (!port) return fail(port.error().code, config().name, port.error().text());
    line_ = std::move(*port);
    server_->serve_line(line_.get(), {times_of(*settings_.serial), false});
    return {};
  }
  auto pty = serial::PseudoTerminal::open(settings_.pty);
  if (!pty) return fail(pty.error().code, config().name, pty.error().text());
  pty_.emplace(std::move(*pty));
  server_->serve_line(pty_->line(), {times_of(*settings_.serial), true});
  return {};
}

Status ModbusEmulator::do_arm(const ArmContext&) {
  const auto model = parts_.registers ? parts_.registers : settings_.registers;
  if (!model)
    return fail(
        ErrorCode::bad_input, config().params.place(),
        config().name +
            ": expected a model with registers (such as `model: turntable`) or a list `registers`, got "
            "neither");
  server_ = std::make_unique<Server>(
      model, [] { return bench_now(); }, settings_.options, std::make_shared<FaultBox>(settings_.faults));
  server_->on_clients(
      [this](unsigned clients) { health_.connected.store(clients != 0, std::memory_order_release); });
  const auto s = settings_.serial ? open_line() : server_->listen(settings_.address, settings_.port);
  if (!s) server_.reset();
  return s;
}

Status ModbusEmulator::do_start(BenchTime) { return server_->start(); }

Status ModbusEmulator::do_stop() {
  server_->stop();
  server_.reset();
  pty_.reset();
  line_ = {};
  health_.connected.store(false, std::memory_order_release);
  return {};
}

}  // namespace rigor::modbus
