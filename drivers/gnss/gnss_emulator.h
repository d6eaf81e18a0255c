// A simulated receiver that leaves the bench as a real one, on a pseudo-terminal or a TCP port: other
// programs, gpsd for one, take it for a u-blox receiver. Keys: gnss_settings.h.
//
// Its instants lie on whole periods of UTC by this machine's clock, as those of a receiver do.
#pragma once

#include <atomic>
#include <memory>
#include <optional>
#include <thread>

#include "drivers/gnss/measured_fix.h"
#include "drivers/serial/device_end.h"
#include "rt-core/deadline.h"
#include "sensor-hal/channel/emulator.h"

namespace rigor::gnss {

/// `health().connected`: a host is there now; `received`: instants that were sent; `lost`: those that a host
/// did not read in time.
class GnssEmulator final : public Emulator {
 public:
  ~GnssEmulator() override;
  void attach(DeviceParts parts) override { parts_ = std::move(parts); }
  [[nodiscard]] std::string endpoint() const override;
  /// The terminal that hosts open, or "address:port"; once armed.
  [[nodiscard]] std::string where() const { return end_ ? end_->endpoint() : std::string(); }
  struct Counters {
    std::atomic<std::uint64_t> requests{0}, refused{0}, rtcm{0}, malformed{0}, hosts{0};
  };
  [[nodiscard]] const Counters& counters() const noexcept { return counters_; }

 protected:
  Status do_configure(const ChannelConfig& config) override;
  Status do_arm(const ArmContext& context) override;
  Status do_start(BenchTime t0) override;
  Status do_stop() override;

 private:
  void run(BenchTime t0);

  DeviceParts parts_;
  EmulatorSettings settings_;
  std::unique_ptr<serial::DeviceEnd> end_;
  Deadline deadline_;
  std::thread thread_;
  Counters counters_;
};

}  // namespace rigor::gnss
