// Fog, rain and snow in C++, over any number type: see air.glsl.h.
//
//   AirMath<double>::air_fog_extinction_per_m(200, 905);    // 0.0196 per metre at 200 m visibility
//
// All functions: any thread, no allocation, no state.
#pragma once

#include "sensor-hal/models/one_source.h"

namespace rigor::models {

#define FN static inline
template <class REAL>
struct AirMath {
#include "sensor-hal/models/air/air.glsl.h"
};
#undef FN

}  // namespace rigor::models
