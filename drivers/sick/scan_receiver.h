// What the source over TCP and its stand-in in virtual time share: telegrams in, samples out, losses counted.
#pragma once

#include <cstdint>
#include <optional>

#include "drivers/sick/scan_geometry.h"
#include "sensor-hal/types/sample.h"

namespace rigor::sick {

/// Numbers scans and finds the ones that are missing. One thread.
class ScanSequence {
 public:
  struct Step {
    std::uint64_t sequence = 0, lost = 0;
  };
  /// `interval`: scans of the device from telegram to telegram. The scan counter counts the device's scans
  /// modulo 2^16; over a break (`resume`) it is the time that counts.
  [[nodiscard]] Step step(std::uint16_t scan_counter, std::uint16_t interval, BenchTime t_capture,
                          Duration period) noexcept;
  /// The connection was lost: what comes next is counted by its time.
  void resume() noexcept { by_time_ = true; }
  void reset() noexcept { *this = {}; }

 private:
  bool any_ = false, by_time_ = false;
  std::uint16_t counter_ = 0;
  std::uint64_t sequence_ = 0;
  BenchTime last_;
};

/// The device says that its measurement is in error.
[[nodiscard]] inline bool in_error(const ScanData& scan) { return (scan.device_status[1] & 0x01) != 0; }

}  // namespace rigor::sick
