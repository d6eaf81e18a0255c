// The scanner that an entry of `emulators` describes, measuring what the world gives it.
//
//   model: urg-04lx           or utm-30lx
//   serial: H0000000
//   clock_ppm: 0              how fast its clock runs
//   clock_start_ms: 0         what its clock shows at power-on
#pragma once

#include <deque>
#include <memory>

#include "drivers/usb/scip_points.h"
#include "sensor-hal/channel/emulator.h"

namespace rigor::usb {

struct EmulatedScannerSettings {
  ScannerModel model;
  ScipDevice::Options options;
};
/// Throws ConfigError.
[[nodiscard]] EmulatedScannerSettings read_emulated_scanner(const ConfigNode& n);

/// Measures by a SampleProvider. One thread at a time.
class WorldScans {
 public:
  /// `power_on`: bench time of device time 0; `first_scan`: the one that gets capture index 0.
  WorldScans(DeviceParts parts, const ScannerModel& model, BenchTime power_on, std::uint64_t first_scan = 0);
  /// As ScipDevice::Measure.
  bool measure(std::uint64_t scan, DeviceTime t_first, std::span<std::uint32_t> range_mm,
               std::span<std::uint32_t> intensity);
  /// Notes how the world moves at the beginning of a scan that is measured later. In order.
  void remember_motion(DeviceTime t_first);

 private:
  DeviceParts parts_;
  const ScannerModel model_;
  BenchTime power_on_;
  std::uint64_t first_scan_;
  Sample sample_;
  std::deque<std::pair<DeviceTime, WorldMotion>> motions_;
};

}  // namespace rigor::usb
