// The time pulse of a receiver as the kernel stamps it: /dev/ppsN (RFC 2783), of a GPIO or, by `ldattach PPS
// /dev/ttyS0`, of a serial port's DCD line.
#pragma once

#include <optional>
#include <string>

#include "drivers/serial/serial_line.h"
#include "rt-core/epoch.h"
#include "rt-core/file_descriptor.h"

namespace rigor::gnss {

/// One thread.
class PulseInput {
 public:
  /// not_found, unavailable: with what to do. Setup.
  [[nodiscard]] Status open(const std::string& device);
  void close() { fd_ = {}; }
  struct Edge {
    BenchTime before, after;  ///< the edge lies between: the uncertainty of UTC on the bench clock
  };
  /// Waits at most this long for an edge that was not given yet. I/O thread.
  [[nodiscard]] std::optional<Edge> next(Duration at_most);

 private:
  FileDescriptor fd_;
  std::uint32_t last_ = 0;
  bool any_ = false;
};

}  // namespace rigor::gnss
