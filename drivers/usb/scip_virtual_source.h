// A scanner's channel in virtual time: the emulated scanner's model and both sides of the protocol in
// process, byte for byte, in place of the device; without socket, thread or clock. Keys as ScipSource; those
// of the transport are read and have no effect.
//
// The mirror passes the first step of the detection range at t0 + k·period, so that a simulated side measures
// at the same instants. Stamps are what the protocol makes of that: whole milliseconds of the scanner's
// clock, mapped by TM and II, with the sigma that this leaves.
#pragma once

#include "drivers/usb/emulated_scanner.h"
#include "drivers/usb/scan_keeper.h"
#include "drivers/usb/usb_settings.h"
#include "sensor-hal/channel/stream_source.h"

namespace rigor::usb {

class ScipVirtualSource final : public StreamSource {
 public:
  /// `emulator_params`: the entry that stands for the device in the rig.
  ScipVirtualSource(DeviceParts parts, ConfigNode emulator_params);
  ~ScipVirtualSource() override;
  void complete_until(BenchTime now) override;

 protected:
  Status do_configure(const ChannelConfig& config) override;
  Status do_arm(const ArmContext& context) override;
  Status do_start(BenchTime t0) override;
  Status do_stop() override;

 private:
  /// Carries bytes to and fro until neither has more.
  void exchange(BenchTime now);
  void open_session(BenchTime from);
  void take_scans();

  DeviceParts parts_;
  ConfigNode emulator_params_;
  ScipSettings settings_;
  EmulatedScannerSettings scanner_;
  std::unique_ptr<WorldScans> world_;
  std::unique_ptr<ScipDevice> device_;
  std::unique_ptr<ScipClient> client_;
  ScanKeeper keeper_;
  ScipScan scan_;
  BenchTime power_on_;
  BenchTime next_begin_;  ///< of the next scan whose motion is not yet noted
  std::uint64_t broken_seen_ = 0;
};

}  // namespace rigor::usb
