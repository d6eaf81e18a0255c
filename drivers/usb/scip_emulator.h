// A simulated scanner that leaves the bench as a real one.
//
//   as: pty       a pseudo-terminal; `link: /tmp/scanner` gives it a name that stays
//   as: tcp       a socket: address (127.0.0.1), port (10940; 0 takes a free one); one client at a time,
//   which is
//                 dropped when it neither measures nor gives a whole command for idle_limit_s (60; 0: never)
//   as: gadget    a USB device (CDC-ACM) of this machine, through its device controller or dummy_hcd:
//                 vendor 0x15d1, product 0x0000, udc (the first that is free); usb_gadget.h
//
// and the keys of emulated_scanner.h. `health().connected`: a client is there; of a gadget: it measures or
// the host talked to it lately.
#pragma once

#include <atomic>
#include <functional>
#include <mutex>
#include <thread>

#include "drivers/usb/device_ends.h"
#include "drivers/usb/emulated_scanner.h"
#include "rt-core/deadline.h"

namespace rigor::usb {

class ScipEmulator final : public Emulator {
 public:
  ~ScipEmulator() override;
  void attach(DeviceParts parts) override { parts_ = std::move(parts); }
  [[nodiscard]] std::string endpoint() const override;

  /// The terminal that clients open, or "address:port"; once armed.
  [[nodiscard]] std::string where() const { return end_ ? end_->endpoint() : std::string(); }
  struct Counters {
    std::atomic<std::uint64_t> scans_sent{0}, scans_dropped{0}, scans_missing{0}, commands{0}, hosts{0};
  };
  [[nodiscard]] const Counters& counters() const noexcept { return counters_; }
  /// Measures instead of the world, for tests; before arm.
  void measure_by(ScipDevice::Measure measure) { measure_ = std::move(measure); }

 protected:
  Status do_configure(const ChannelConfig& config) override;
  Status do_arm(const ArmContext& context) override;
  Status do_start(BenchTime t0) override;
  Status do_stop() override;

 private:
  void run();
  void set_connected(bool is) noexcept { health_.connected.store(is, std::memory_order_release); }

  DeviceParts parts_;
  EmulatedScannerSettings scanner_;
  ScipDevice::Measure measure_;
  std::function<std::unique_ptr<DeviceEnd>()> make_end_;
  Duration idle_limit_;  ///< of a socket's client without a whole command or a measurement; 0: none
  std::unique_ptr<DeviceEnd> end_;
  Deadline deadline_;
  std::thread thread_;
  Counters counters_;
};

}  // namespace rigor::usb
