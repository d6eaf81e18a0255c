// A register model as a Modbus TCP device on the network.
//
//   emulators:
//     turntable: { backend: modbus, address: 127.0.0.1, port: 5020, … }
//
// Keys: address (127.0.0.1), port (502; 0 takes a free one), max_clients (8), idle_limit_s (60; 0: never),
// and faults: { response_delay_ms, exception_every, exception_code, silent_every }.
#pragma once

#include <memory>

#include "drivers/modbus/modbus_server.h"
#include "sensor-hal/channel/emulator.h"

namespace rigor::modbus {

/// `health().connected`: a client is there now.
class ModbusEmulator final : public Emulator {
 public:
  ~ModbusEmulator() override;
  void attach(DeviceParts parts) override;
  [[nodiscard]] std::string endpoint() const override;

  /// The port that is served, once armed.
  [[nodiscard]] std::uint16_t port() const noexcept;
  /// Any thread, while armed or running.
  void set_faults(const ServerFaults& faults);
  /// Server counters; null before arm.
  [[nodiscard]] const Server* server() const noexcept { return server_.get(); }

 protected:
  Status do_configure(const ChannelConfig& config) override;
  Status do_arm(const ArmContext& context) override;
  Status do_start(BenchTime t0) override;
  Status do_stop() override;

 private:
  DeviceParts parts_;
  std::string address_;
  std::uint16_t port_ = 0;
  Server::Options options_;
  std::unique_ptr<Server> server_;
};

}  // namespace rigor::modbus
