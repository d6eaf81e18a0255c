// The device itself, without a socket: a simulated LiDAR whose firings become packets of points. The emulator
// sends these packets, virtual time decodes them in process.
//
//   firing n     is 5 µs after the one before; asked of the simulator in scans of scan_time()
//   packet j     firings 96 j to 96 j + 95; filled when the last of them has fired. udp_cnt counts from 0 in
//   each
//                100 ms of the device's time
//
// Times are nanoseconds since the device's start. One thread at a time.
#pragma once

#include <functional>
#include <memory>
#include <vector>

#include "drivers/lidar/scan_ahead.h"
#include "drivers/livox/livox_packet.h"

namespace rigor::livox {

/// What the device's timestamps count, and what they are at its start.
struct DeviceClock {
  TimeType type = TimeType::none;
  std::uint64_t start_ns = 0;
};

class Mid360Device {
 public:
  /// bad_input: the simulated scan does not fire as such a device; says in what it differs.
  [[nodiscard]] static Result<Mid360Device> create(std::shared_ptr<SampleProvider> samples);

  [[nodiscard]] Duration scan_time() const { return Duration(empty_.scan().pattern_scan_ns); }
  [[nodiscard]] Duration begin(std::uint64_t scan) const {
    return Duration(empty_.scan().pattern_scan_ns * static_cast<std::int64_t>(scan));
  }
  [[nodiscard]] static Duration filled(std::uint64_t packet) {
    return Duration(static_cast<std::int64_t>((packet + 1) * kDots) * kPoint_ns);
  }
  /// The last scan that packet j has a firing of.
  [[nodiscard]] std::uint64_t last_scan_of(std::uint64_t packet) const {
    return ((packet + 1) * kDots - 1) / firings();
  }

  [[nodiscard]] packet_lidar::Scan make_scan() const { return {0, false, empty_}; }
  /// Measures; `t_begin` is the bench time of begin(index). May take milliseconds.
  [[nodiscard]] Status measure(std::uint64_t index, BenchTime t_begin, const WorldMotion& motion,
                               packet_lidar::Scan& out);

  /// Packet j of the scans that it needs: `of(k)` gives scan k, nullptr where there is none (then there are
  /// no returns). `out` is replaced.
  void compose(std::uint64_t packet, DataType type, const DeviceClock& clock,
               const std::function<const packet_lidar::Scan*(std::uint64_t)>& of,
               std::vector<std::uint8_t>& out) const;

 private:
  Mid360Device(std::shared_ptr<SampleProvider> samples, models::ScanGrid grid);
  [[nodiscard]] std::uint64_t firings() const { return std::uint64_t{empty_.columns()} * empty_.beams(); }

  std::shared_ptr<SampleProvider> samples_;
  models::ScanGrid empty_;
  Sample sample_;
};

/// The reading of a unit at rest, level, which is what an emulated device has.
[[nodiscard]] inline ImuReading at_rest() { return {{0, 0, 0}, {0, 0, 1}}; }
inline constexpr std::int64_t kImuPeriod_ns = 5'000'000;

}  // namespace rigor::livox
