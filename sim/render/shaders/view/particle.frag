#version 460
#extension GL_GOOGLE_include_directive : require
#include "sim/render/shaders/view/bindings.glsl"
#include "sim/render/shaders/view/light.glsl"
layout(constant_id = 7) const bool kHaze = false;
layout(constant_id = 9) const bool kSnow = false;
layout(location = 0) in vec2 across;
layout(location = 1) flat in float covers;
layout(location = 2) in vec3 p;
layout(location = 0, index = 0) out vec4 radiance;
layout(location = 0, index = 1) out vec4 shines_through;

void main() {
  float a = covers * clamp(1.0 - dot(across, across) * (kSnow ? 1.0 : 0.5), 0.0, 1.0);
  // A drop shows a picture of nearly everything round it, upside down; a flake is white all round.
  vec4 light = (sky_irradiance(vec3(0.0, 0.0, 1.0)) + sky_irradiance(vec3(0.0, 0.0, -1.0))) / (2.0 * kPi);
  if (kSnow) light = frame.snow * (light + frame.sun_irradiance * (0.25 / kPi));
  if (kHaze) light = through_air(light, p);
  radiance = light * a;
  shines_through = vec4(1.0 - a);
}
