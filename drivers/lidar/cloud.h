// A point cloud with its place on the bench clock, as a stream of packets gives it, before it is a sample.
#pragma once

#include <cstdint>
#include <functional>
#include <span>

#include "rt-core/time.h"
#include "sensor-hal/types/sample.h"

namespace rigor::packet_lidar {

struct Cloud {
  std::span<const LidarPoint> points;  ///< until the next packet
  BenchTime t_capture;
  Duration sigma;
  std::uint64_t sequence = 0;      ///< a gap is a loss
  std::uint64_t lost_before = 0;   ///< clouds
  std::uint32_t packets_lost = 0;  ///< within
  std::uint32_t validity = 0;
};

using HandCloud = std::function<void(const Cloud&)>;

}  // namespace rigor::packet_lidar
