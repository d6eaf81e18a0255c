// A point cloud with its place on the bench clock, as a stream of packets gives it, before it is a sample.
#pragma once

#include <cstdint>
#include <functional>
#include <span>

#include "rt-core/time.h"
#include "sensor-hal/types/sample.h"

namespace rigor::packet_lidar {

struct Cloud {
  // Until the next packet:
  std::span<const LidarPoint> points;
  std::span<const std::uint8_t> pixels;  ///< of a channel of images, in place of points
  BenchTime t_capture;
  Duration sigma;
  std::uint64_t sequence = 0;      ///< a gap is a loss
  std::uint64_t lost_before = 0;   ///< clouds
  std::uint32_t packets_lost = 0;  ///< within
  std::uint32_t validity = 0;
};

using HandCloud = std::function<void(const Cloud&)>;

}  // namespace rigor::packet_lidar
