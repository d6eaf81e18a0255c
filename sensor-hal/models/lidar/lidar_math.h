// The LiDAR model in C++, over any number type: see lidar.glsl.h.
//
//   LidarMath<double>::lidar_range_sigma_m(0.3, 0, 0.0065, 0.19, 1);
//
// A calibrator includes Ceres first. All functions: any thread, no allocation, no state.
#pragma once

#include "sensor-hal/models/one_source.h"

namespace rigor::models {

using std::cos;
using std::sin;

#define FN static inline
#define OUT(type) type&
template <class REAL>
struct LidarMath {
#include "sensor-hal/models/lidar/lidar.glsl.h"
};
#undef FN
#undef OUT

}  // namespace rigor::models
