// A simulated LiDAR as a SICK scanner on the network.
//
//   emulators:
//     front: { backend: sick, device: lms1xx, port: 2112, sensor: ../sensors/sick-lms111.yaml,
//     T_world_sensor: … }
//
// Keys beside those of the sensor and of the device (sick_settings.h): address (127.0.0.1), port (2112; 0
// takes a free one), max_clients (8), idle_limit_s (60).
#pragma once

#include <memory>

#include "drivers/sick/scanner_server.h"
#include "sensor-hal/channel/emulator.h"

namespace rigor::sick {

/// `health().connected`: a client is there now; `received`: scans given out; `lost`: scans that were not made
/// in time.
class SickEmulator final : public Emulator {
 public:
  SickEmulator();
  ~SickEmulator() override;
  void attach(DeviceParts parts) override;
  [[nodiscard]] std::string endpoint() const override;
  /// The port that is served, once armed.
  [[nodiscard]] std::uint16_t port() const noexcept;
  /// Null before arm.
  [[nodiscard]] const ScannerServer* server() const noexcept { return server_.get(); }

 protected:
  Status do_configure(const ChannelConfig& config) override;
  Status do_arm(const ArmContext& context) override;
  Status do_start(BenchTime t0) override;
  Status do_stop() override;

 private:
  class Capture;
  DeviceParts parts_;
  std::string address_;
  std::uint16_t port_ = 0;
  ScannerConfig scanner_;
  ScannerServer::Options options_;
  std::unique_ptr<Capture> capture_;
  std::unique_ptr<ScannerServer> server_;
};

}  // namespace rigor::sick
