// A Hokuyo scanner as a channel, over USB, a terminal or a socket. Keys: usb_settings.h.
//
// arm opens the device, reads what it is and its clock, checks the settings against it, and has it scan. A
// thread of the channel's own then carries the bytes; scans of before the run are discarded. Each scan's
// stamp (the scanner's clock at step 0) is mapped to bench time by what TM and II tell of that clock.
// t_capture is when the first step of the detection range was measured; each point's t_offset_ns follows from
// the rotation.
//
// A scanner that goes away (unplugged in the middle of a transfer, silent, refusing) takes `connected` with
// it; it is tried again at once when the system says that it is back, and with pauses from 50 ms to 2 s.
// The scans that should have come meanwhile count as lost.
#pragma once

#include <thread>

#include "drivers/usb/scan_keeper.h"
#include "drivers/usb/usb_settings.h"
#include "sensor-hal/channel/backoff.h"
#include "sensor-hal/channel/stream_source.h"

namespace rigor::usb {

/// `rate_hz`, where there is one, against what the scanner does. Setup.
[[nodiscard]] Status check_rate(const ChannelConfig& config, const ScannerParameters& parameters,
                                std::uint32_t skip);

class ScipSource final : public StreamSource {
 public:
  explicit ScipSource(LinkFactory links) : links_(std::move(links)) {}
  ~ScipSource() override;
  [[nodiscard]] std::vector<std::string> warnings() const override { return warnings_; }
  [[nodiscard]] const ScannerParameters& parameters() const noexcept { return client_->parameters(); }
  [[nodiscard]] const ScannerIdentity& identity() const noexcept { return client_->identity(); }
  /// Of the link, as of the last stop.
  [[nodiscard]] ByteLink::Counters link_counters() const noexcept { return link_counters_; }

 protected:
  Status do_configure(const ChannelConfig& config) override;
  [[nodiscard]] bool requires_wall_clock() const noexcept override { return true; }
  Status do_arm(const ArmContext& context) override;
  Status do_stop() override;

 private:
  void run();
  /// One exchange. False: the session is over, `why_` says why (cut: empty).
  bool exchange(MonotonicTime until);
  [[nodiscard]] Status check_scanner() const;
  void take_scans();
  void lose();

  LinkFactory links_;
  ScipSettings settings_;
  std::unique_ptr<ByteLink> link_;
  std::unique_ptr<ScipClient> client_;
  ScanKeeper keeper_;
  Backoff backoff_;
  ByteLink::Counters link_counters_;
  std::vector<std::string> warnings_;
  std::string why_;
  std::vector<char> buffer_;
  ScipScan scan_;
  std::uint64_t broken_seen_ = 0, retries_seen_ = 0;
  bool cut_ = false;
  std::thread thread_;
};

}  // namespace rigor::usb
