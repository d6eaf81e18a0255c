// The time-of-flight pixel in C++, over any number type: the file that shaders include. See tof.glsl.h; a
// calibrator includes Ceres first (one_source.h). Any thread, no allocation, no state.
#pragma once

#include "sensor-hal/models/one_source.h"

namespace rigor::models {

#define FN static inline
#define OUT(type) type&
#define UINT std::uint32_t

template <class REAL>
struct TofMath {
#include "sensor-hal/models/random_draws.glsl.h"
//
#include "sensor-hal/models/tof/tof.glsl.h"
};

#undef FN
#undef OUT
#undef UINT

}  // namespace rigor::models
