// A register model as a Modbus device on the network or on a serial line.
//
//   emulators:
//     turntable: { backend: modbus, address: 127.0.0.1, port: 5020, … }
//     meter:     { backend: modbus, transport: rtu, pty: /tmp/meter, baud: 19200, unit: 1, registers: […] }
//
// Keys: `transport` (tcp, rtu), `unit`; of TCP `address` (127.0.0.1), `port` (502; 0 takes a free one),
// `max_clients` (8); of RTU the line's settings and either `pty` (a pseudo-terminal is made, with this link
// to it) or `device` (a serial port); `idle_limit_s` (60; 0: never); `registers`: a device of plain registers
// (register_bank.h), where no model was attached; `faults`: { response_delay_ms, exception_every,
// exception_code, silent_every, from_s, for_s }.
#pragma once

#include <memory>
#include <optional>

#include "drivers/modbus/modbus_link.h"
#include "drivers/modbus/modbus_server.h"
#include "sensor-hal/channel/emulator.h"

namespace rigor::modbus {

/// What an emulator and its stand-in for virtual time read of their keys.
struct EmulatorSettings {
  std::string address = "127.0.0.1";
  std::uint16_t port = 0;
  std::optional<SerialSettings> serial;  ///< RTU; `device` is empty where a pseudo-terminal is made
  std::string pty;                       ///< the link to it
  Server::Options options;
  ServerFaults faults;
  std::shared_ptr<RegisterModel> registers;  ///< of the key `registers`, or null

  /// Throws ConfigError.
  [[nodiscard]] static EmulatorSettings parse(const ConfigNode& n);
};

/// `health().connected`: a client is there now.
class ModbusEmulator final : public Emulator {
 public:
  ~ModbusEmulator() override;
  void attach(DeviceParts parts) override;
  [[nodiscard]] std::string endpoint() const override;

  /// The port that is served, once armed.
  [[nodiscard]] std::uint16_t port() const noexcept;
  /// The serial port that clients open, once armed; empty on TCP.
  [[nodiscard]] std::string device() const;
  /// Any thread, while armed or running; from the next request on. `from` is counted from the start.
  void set_faults(const ServerFaults& faults);
  /// Server counters; null before arm.
  [[nodiscard]] const Server* server() const noexcept { return server_.get(); }

 protected:
  Status do_configure(const ChannelConfig& config) override;
  Status do_arm(const ArmContext& context) override;
  Status do_start(BenchTime t0) override;
  Status do_stop() override;

 private:
  Status open_line();

  DeviceParts parts_;
  EmulatorSettings settings_;
  std::optional<serial::PseudoTerminal> pty_;
  FileDescriptor line_;
  std::unique_ptr<Server> server_;
};

}  // namespace rigor::modbus
