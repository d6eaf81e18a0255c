#version 460
// Each of the error models as a shader runs it; see model_calls.glsl.h.
#extension GL_GOOGLE_include_directive : require
#include "sensor-hal/models/one_source.glsl.h"
#include "sensor-hal/models/angles.glsl.h"
#include "sensor-hal/models/opencv_lens.glsl.h"
#include "sensor-hal/models/fisheye_lens.glsl.h"
#include "sensor-hal/models/depth_of_field.glsl.h"
#include "sensor-hal/models/vignetting.glsl.h"
#include "sensor-hal/models/random_draws.glsl.h"
#include "sensor-hal/models/dark_current.glsl.h"
#include "sensor-hal/models/emva_noise.glsl.h"
#include "sensor-hal/models/bloom.glsl.h"
#include "sensor-hal/models/image_processing.glsl.h"
#include "sensor-hal/models/lidar/lidar.glsl.h"
#include "sensor-hal/models/air/air.glsl.h"
#include "sensor-hal/models/tof/tof.glsl.h"
#include "tests/sim/render/model_shader/model_calls.glsl.h"
layout(local_size_x = 64) in;
layout(std430, set = 0, binding = 0) readonly buffer Arguments { float arguments[]; };
layout(std430, set = 0, binding = 1) writeonly buffer Results { float results[]; };
layout(push_constant) uniform Push { int which; uint count; };
void main() {
  uint n = gl_GlobalInvocationID.x;
  if (n >= count) return;
  uint o = n * 12u;
  float p, q, r, s;
  model_call(which, arguments[o], arguments[o + 1u], arguments[o + 2u], arguments[o + 3u], arguments[o + 4u],
             arguments[o + 5u], arguments[o + 6u], arguments[o + 7u], arguments[o + 8u], arguments[o + 9u],
             arguments[o + 10u], arguments[o + 11u], p, q, r, s);
  results[n * 4u] = p;
  results[n * 4u + 1u] = q;
  results[n * 4u + 2u] = r;
  results[n * 4u + 3u] = s;
}
