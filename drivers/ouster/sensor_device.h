// The device itself, without a socket: a simulated LiDAR whose columns and beams become lidar packets. The
// emulator sends these packets, virtual time decodes them in process.
//
//   frame k    the columns of one turn, which divide it evenly; asked of the simulator as one scan
//   packet j   columns_per_packet columns of frame j / slots, slot j % slots; filled when its last column has
//              fired
//
// The simulated scan says what the sensor is: turns clockwise, all beams of a column at once; its elevations
// and azimuths are the metadata's beam angles, where its beams begin is lidar_origin_to_beam_origin, where it
// begins to turn and its vertical offset are lidar_to_sensor_transform. Modes of fewer columns take every
// second or fourth.
//
// Times are nanoseconds since the device's start. One thread at a time.
#pragma once

#include <functional>
#include <memory>

#include "drivers/lidar/scan_ahead.h"
#include "drivers/ouster/lidar_packet.h"
#include "sensor-hal/channel/emulator.h"

namespace rigor::ouster {

/// What a client can change of a sensor that runs.
struct DeviceMode {
  Profile profile = Profile::single;
  LidarMode lidar;
  ColumnWindow window;
  bool operator==(const DeviceMode&) const = default;
};

class SensorDevice {
 public:
  /// bad_input: the simulated scan is not that of such a sensor; says in what it differs.
  [[nodiscard]] static Result<SensorDevice> create(std::shared_ptr<SampleProvider> samples);

  /// The mode that the simulated scan has.
  [[nodiscard]] LidarMode scan_mode() const { return scan_mode_; }
  /// Whether the simulated scan holds the columns of this mode.
  [[nodiscard]] bool offers(const LidarMode& mode) const {
    return mode.rate_hz == scan_mode_.rate_hz && mode.columns >= 512 &&
           scan_mode_.columns % mode.columns == 0;
  }
  /// Beams and format of the sensor in this mode; names, ports and ids are left empty. Precondition: offers.
  [[nodiscard]] Metadata metadata(const DeviceMode& mode) const;

  [[nodiscard]] Duration frame_time() const { return seconds_from(1.0 / scan_mode_.rate_hz); }
  /// Of frame k, and of packet `slot` of it, when its last column has fired.
  [[nodiscard]] Duration begin(std::uint64_t frame) const;
  [[nodiscard]] Duration filled(std::uint64_t frame, std::uint32_t slot, const Metadata& metadata) const;

  /// Room for one frame.
  [[nodiscard]] packet_lidar::Scan make_scan() const { return {0, false, empty_}; }
  /// Measures; `t_begin` is the bench time of begin(index). May take milliseconds.
  [[nodiscard]] Status measure(std::uint64_t index, BenchTime t_begin, const WorldMotion& motion,
                               packet_lidar::Scan& out);

  /// Packet `slot` of a frame; `start_ns`: the sensor's time at the device's start. A frame that was not
  /// measured has no returns. `writer` has the layout of `metadata`.
  void compose(std::uint64_t frame, std::uint32_t slot, const packet_lidar::Scan* scan,
               const Metadata& metadata, std::uint64_t start_ns, LidarPacketWriter& writer) const;

 private:
  SensorDevice(std::shared_ptr<SampleProvider> samples, models::ScanGrid grid, LidarMode mode);
  std::shared_ptr<SampleProvider> samples_;
  models::ScanGrid empty_;
  LidarMode scan_mode_;
  Sample sample_;
};

}  // namespace rigor::ouster
