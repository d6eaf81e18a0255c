#include "drivers/modbus/modbus_emulator.h"

namespace rigor::modbus {
namespace {

ServerFaults parse_faults(const ConfigNode& n) {
  ServerFaults f;
  f.response_delay = seconds_from(n.number_or("response_delay_ms", 0, {.min = 0, .max = 60000}) * 1e-3);
  f.exception_every = static_cast<std::uint32_t>(n.integer_or("exception_every", 0, {.min = 0, .max = 1e9}));
  f.exception_code = static_cast<std::uint8_t>(n.integer_or("exception_code", 4, {.min = 1, .max = 11}));
  f.silent_every = static_cast<std::uint32_t>(n.integer_or("silent_every", 0, {.min = 0, .max = 1e9}));
  n.finish();
  return f;
}

}  // namespace

ModbusEmulator::~ModbusEmulator() {
  if (state() == ChannelState::armed || state() == ChannelState::running) (void)stop();
}

void ModbusEmulator::attach(DeviceParts parts) { parts_ = std::move(parts); }

std::string ModbusEmulator::endpoint() const {
  const bool six = address_.find(':') != std::string::npos;
  return "Modbus TCP device " + config().name + " at " + (six ? "[" + address_ + "]" : address_) + ":" +
         std::to_string(port());
}

std::uint16_t ModbusEmulator::port() const noexcept {
  return server_ && server_->port() != 0 ? server_->port() : port_;
}

void ModbusEmulator::set_faults(const ServerFaults& faults) {
  if (server_) server_->set_faults(faults);
}

Status ModbusEmulator::do_configure(const ChannelConfig& config) {
  const auto& n = config.params;
  address_ = n.text_or("address", "127.0.0.1");
  port_ = static_cast<std::uint16_t>(n.integer_or("port", 502, {.min = 0, .max = 65535}));
  options_ = {};
  options_.max_clients = static_cast<unsigned>(n.integer_or("max_clients", 8, {.min = 1, .max = 1000}));
  options_.idle_limit = seconds_from(n.number_or("idle_limit_s", 60, {.min = 0, .max = 1e6}));
  options_.faults = parse_faults(n.map_or_absent("faults"));
  description_.kind = SampleKind::register_block;
  description_.frame_id = config.name;
  return {};
}

Status ModbusEmulator::do_arm(const ArmContext& context) {
  if (context.virtual_time)
    return fail(ErrorCode::wrong_state, config().name,
                "expected a wall-clock run: sockets have no virtual time");
  if (!parts_.registers)
    return fail(ErrorCode::bad_input, config().params.place(),
                config().name + ": expected a model with registers (such as `model: turntable`), got none");
  auto server = std::make_unique<Server>(
      parts_.registers, [] { return BenchTime(monotonic_now().ns()); }, options_);
  server->on_clients(
      [this](unsigned clients) { health_.connected.store(clients != 0, std::memory_order_release); });
  if (auto s = server->listen(address_, port_); !s) return s;
  server_ = std::move(server);
  return {};
}

Status ModbusEmulator::do_start(BenchTime) { return server_->start(); }

Status ModbusEmulator::do_stop() {
  server_->stop();
  server_.reset();
  health_.connected.store(false, std::memory_order_release);
  return {};
}

}  // namespace rigor::modbus
