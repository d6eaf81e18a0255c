// From a packet to points: per-laser firing times, the rotor's azimuth at each, and the laser's calibration.
//
// The azimuth of a block is that of its first laser; the others fire while the rotor turns on, at the rate
// that the next block tells (for the last block, the block before; across a sector that the device was told
// to leave out, the last rate that was plausible). Position of a return at range r:
//   a = −(azimuth at the firing) + azimuth correction        anticlockwise about z, x forward
//   p = r·(cos e·cos a, cos e·sin a, sin e) + horizontal offset·(−sin a, cos a, 0) + (0, 0, vertical offset)
// (VLP-16 manual, section 9.2, in axes x forward, y left. ros-drivers/velodyne tilts the vertical offset with
// the beam, which differs by up to 3 mm.)
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "drivers/velodyne/velodyne_device.h"
#include "sensor-hal/types/sample.h"

namespace rigor::velodyne {

enum class RingOrder : std::uint8_t { laser, elevation };  ///< what LidarPoint::ring counts

struct DecodedPacket {
  struct Sequence {
    double azimuth_cdeg = 0;             ///< of laser 0, 0 … 36000
    std::int64_t offset_ns = 0;          ///< of laser 0 against the packet's time
    std::uint32_t first = 0, count = 0;  ///< its points
  };
  std::array<Sequence, 2 * kBlocks> sequences;
  std::uint32_t sequence_count = 0;
  std::array<LidarPoint, kMaxReturns>
      points;  ///< in the order of firing; t_offset_ns against the packet's time
  std::uint32_t point_count = 0;
};

class PacketDecoder {
 public:
  /// Setup. bad_input: a calibration for another number of lasers.
  [[nodiscard]] static Result<PacketDecoder> create(Model model, const Calibration& calibration,
                                                    RingOrder rings = RingOrder::laser);
  /// Any one thread, no allocation. Dual: the last return has return_index 1; the other, where it is another,
  /// 0; a firing with one return has that alone, with index 0.
  void decode(const DataPacket& packet, DecodedPacket& out) const noexcept;
  [[nodiscard]] const DeviceFacts& facts() const { return *facts_; }

 private:
  struct Laser {
    float cos_elevation, sin_elevation, vertical_offset_m, horizontal_offset_m;
    double azimuth_cdeg;  ///< clockwise, is added to the rotor's
    double correction_m;
    double min_intensity, max_intensity, focal_offset, focal_slope;
    std::uint16_t ring;
  };
  PacketDecoder() = default;
  void place(const Laser& laser, double azimuth_cdeg, DataPacket::Return r, LidarPoint& to) const noexcept;

  const DeviceFacts* facts_ = nullptr;
  double range_unit_m_ = kRangeUnit_m;
  std::vector<Laser> lasers_;
};

}  // namespace rigor::velodyne
