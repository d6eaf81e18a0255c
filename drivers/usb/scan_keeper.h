// What turns a scan off the wire into a sample: the scanner's clock on the bench clock, its place in the
// sequence, and how many are missing before it. Shared by the real source and its stand-in.
#pragma once

#include "drivers/usb/scip_client.h"
#include "drivers/usb/scip_points.h"
#include "rt-core/clock_map.h"
#include "sensor-hal/channel/run_origin.h"

namespace rigor::usb {

class ScanKeeper {
 public:
  /// Before a run: what its scans are like.
  void begin(Duration latency, const ScanRequest& request, const ScannerParameters& parameters);
  /// A new session: the scanner may have been switched off and on.
  void forget_clock() noexcept;
  void reading(const ScipClient::Reading& reading) noexcept;

  struct Kept {
    std::uint64_t lost = 0;  ///< scans that are missing since the one before
    bool in_run = true;      ///< false: measured before the run
    bool in_order = true;    ///< false: not later than the one before; it is of no use
  };
  /// When the scan was measured; sequences count from t0. Call once a scan, before `fill`.
  [[nodiscard]] Kept place(const ScipScan& scan, BenchTime arrival, const RunOrigin& origin) noexcept;
  /// The sample's stamp (but `lost_before`), info and bytes.
  void fill(const ScipScan& scan, Sample& sample) const noexcept;
  /// Scans that should have come by `now` and did not: for a run that ends without its scanner.
  [[nodiscard]] std::uint64_t missing_by(BenchTime now) noexcept;

  [[nodiscard]] const ClockMap& clock() const noexcept { return map_; }
  [[nodiscard]] Duration period() const noexcept { return period_; }

 private:
  ClockMap map_{ClockMapOptions{.resolution = milliseconds(1), .step_threshold = milliseconds(20)}};
  ScipClock scip_clock_;
  ScannerParameters parameters_;
  Duration period_, latency_, to_first_step_;
  Stamp stamp_;
  bool any_ = false;
};

}  // namespace rigor::usb
