// What every simulated sensor is asked for, and the truth that comes along.
#pragma once

#include <cstdint>
#include <vector>

#include "rt-core/time.h"
#include "sim/render/engine/content_window.h"

namespace rigor {

struct MeasureRequest {
  std::uint64_t index = 0;  ///< keys the noise
  /// Camera: middle of the exposure of the middle row. Time of flight: middle of the four taps. LiDAR: the
  /// first firing.
  BenchTime t_capture{};
};

/// What a perfect sensor would have known, element by element: pixels row by row, or LiDAR points in their
/// order.
struct GroundTruth {
  std::uint32_t width = 0, height = 0;     ///< points: count, 1
  std::vector<std::uint64_t> node;         ///< NodeId; 0: nothing
  std::vector<std::uint16_t> class_index;  ///< into class_names; 0: nothing
  std::vector<std::string> class_names;    ///< [0] is empty
  std::vector<float> range_m;              ///< along the ray; infinity: nothing
  std::vector<float> normal;               ///< 3 each, sensor frame
  std::vector<float> flow_px;  ///< 2 each, cameras: motion of the point per second in pixels; empty elsewhere
};

}  // namespace rigor
