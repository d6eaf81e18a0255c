#version 460
#extension GL_GOOGLE_include_directive : require
// Once per set-up: for every pixel of the sensor the ideal ray, the vignetting with the gain pattern, and the offset.
#include "sensor-hal/models/one_source.glsl.h"
#include "sensor-hal/models/opencv_lens.glsl.h"
#include "sensor-hal/models/philox.glsl.h"
#include "sensor-hal/models/random_draws.glsl.h"
#include "sensor-hal/models/vignetting.glsl.h"
#define INLINE_CASTERS 16
#include "sim/render/shaders/shared.glsl.h"
layout(local_size_x = 64) in;
layout(std140, set = 0, binding = 6) uniform LensBlock { LensUniforms u; };
layout(std430, set = 0, binding = 7) writeonly buffer MapBlock { vec4 map[]; };

void main() {
  uint pixel = gl_GlobalInvocationID.y * (gl_NumWorkGroups.x * gl_WorkGroupSize.x) + gl_GlobalInvocationID.x;
  if (pixel >= u.sensor.x * u.sensor.y) return;
  float xd = (float(pixel % u.sensor.x) - u.camera.z) / u.camera.x;
  float yd = (float(pixel / u.sensor.x) - u.camera.w) / u.camera.y;
  float x;
  float y;
  float valid;
  lens_undistort(xd, yd, u.lens_a.x, u.lens_a.y, u.lens_a.z, u.lens_a.w, u.lens_b.x, u.lens_b.y, u.lens_b.z, u.lens_b.w,
                 1e-6, x, y, valid);
  float gain = 0.0;
  if (valid > 0.5) {
    gain = vignetting_factor(x, y, u.vignetting.x, u.vignetting.y, u.vignetting.z, u.vignetting.w);
  } else {
    x = 0.0;
    y = 0.0;
  }
  float offset = 0.0;
  if (u.pattern.z > 0.5) {
    uint w0;
    uint w1;
    uint w2;
    uint w3;
    philox4x32_10(pixel, 3u, 0u, 0u, u.sensor.z, u.sensor.w, w0, w1, w2, w3);  // NoiseEffect::camera_fixed_pattern
    gain *= max(1.0 + u.pattern.x * normal_quantile(unit_from_bits(w0)), 0.0);
    offset = u.pattern.y * normal_quantile(unit_from_bits(w1));
  }
  map[pixel] = vec4(x, y, gain, offset);
}
