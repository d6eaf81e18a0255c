// The time-of-flight arithmetic as GLSL: compiles, so that a shader may include it as C++ does.
#version 450
#extension GL_GOOGLE_include_directive : require
#include "sensor-hal/models/one_source.glsl.h"
//
#include "sensor-hal/models/random_draws.glsl.h"
#include "sensor-hal/models/tof/tof.glsl.h"
layout(local_size_x = 64) in;
layout(std430, binding = 0) buffer Values { float v[]; };
void main() {
  uint i = gl_GlobalInvocationID.x;
  float x, y, d0, d1, d2, d3, turns, amplitude, saturated;
  tof_phasor(v[i], 0.0, 0.1, 0.0, 0.0, 0.0, 1.0, 1.0, x, y);
  float e = tof_active_electrons(1.0e5, 1.0, 2.0, 0.5);
  tof_taps(e, e * x, e * y, 0.5, 3.0, d0, d1, d2, d3);
  d0 = tof_read_tap(d0, 0.0, 1e5, 3.0, normal_quantile(0.3), 1.0, saturated);
  tof_demodulate(d0, d1, d2, d3, turns, amplitude);
  v[i] = amplitude + tof_nearest_range(turns, 0.2, 3.0) + tof_range_sigma(0.2, e, 1.0, 1.0, 0.5);
}
