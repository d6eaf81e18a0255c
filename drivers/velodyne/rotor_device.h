// The device itself, without a socket: a rotor that turns evenly, lasers that fire in their order, and
// packets that fill up with what they see. The emulator sends these packets, virtual time decodes them in
// process.
//
//   firing sequence n      begins n · 55.296 µs (46.080 µs) after the start; azimuth = rotation · that time
//   revolution k           the sequences from the first at or past azimuth 0 on. A turn is no whole number of
//                          sequences, so each revolution begins up to a sequence's turn later: it is asked of
//                          the simulator as a scan turned by that much (SampleProvider::Request::turn_rad)
//   packet j               24 sequences (12; half of it with dual returns) from sequence 24·j on
//
// Times are nanoseconds since the device's start. One thread at a time.
#pragma once

#include <array>
#include <functional>
#include <memory>

#include "drivers/lidar/scan_ahead.h"
#include "drivers/velodyne/velodyne_device.h"
#include "sensor-hal/channel/emulator.h"

namespace rigor::velodyne {

struct RotorSettings {
  Model model = Model::vlp16;
  bool dual = false;
  ReturnMode single = ReturnMode::strongest;  ///< what the packets say where they are not dual
  std::uint8_t product = 0x22;                ///< what the packets say
  std::uint32_t start_us = 0;                 ///< the device's time since the hour at its start
};

using Revolution = packet_lidar::Scan;

class RotorDevice {
 public:
  /// bad_input: the simulated scan is not that of this model; says in what it differs.
  [[nodiscard]] static Result<RotorDevice> create(const RotorSettings& settings,
                                                  std::shared_ptr<SampleProvider> samples);

  /// The device's time since the hour at its start.
  void set_start_us(std::uint32_t start_us) { settings_.start_us = start_us; }
  [[nodiscard]] std::int64_t packet_ns() const { return facts_->packet_ns(settings_.dual); }
  [[nodiscard]] double rotation_hz() const { return rotation_hz_; }
  [[nodiscard]] Duration revolution_time() const { return seconds_from(1 / rotation_hz_); }
  /// First sequence of a revolution, and when it begins.
  [[nodiscard]] std::uint64_t first_sequence(std::uint64_t revolution) const;
  [[nodiscard]] std::int64_t begin_ns(std::uint64_t revolution) const {
    return static_cast<std::int64_t>(first_sequence(revolution)) * facts_->sequence_ns;
  }
  /// The last revolution that packet j has a sequence of.
  [[nodiscard]] std::uint64_t last_revolution_of(std::uint64_t packet) const;

  /// Room for one revolution.
  [[nodiscard]] Revolution make_revolution() const;
  /// Measures; `t_begin` is the bench time of begin_ns(index). May take milliseconds.
  [[nodiscard]] Status measure(std::uint64_t index, BenchTime t_begin, const WorldMotion& motion,
                               Revolution& out);

  /// Packet j from the revolutions that it needs: `of(k)` gives revolution k, nullptr where there is none
  /// (then there are no returns).
  void compose(std::uint64_t packet, const std::function<const Revolution*(std::uint64_t)>& of,
               DataPacketWriter& out) const;

 private:
  RotorDevice(const RotorSettings& settings, std::shared_ptr<SampleProvider> samples, models::ScanGrid grid);
  [[nodiscard]] std::uint64_t revolution_of(std::uint64_t sequence) const;
  [[nodiscard]] double azimuth_deg(std::uint64_t sequence) const;

  RotorSettings settings_;
  const DeviceFacts* facts_;
  std::shared_ptr<SampleProvider> samples_;
  models::ScanGrid empty_;
  double rotation_hz_;
  Sample sample_;
};

}  // namespace rigor::velodyne
