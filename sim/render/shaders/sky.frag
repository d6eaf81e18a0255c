#version 460
#extension GL_GOOGLE_include_directive : require
#include "sim/render/shaders/bindings.glsl"
layout(location = 0) in vec2 direction_xy;
layout(location = 0) out vec4 picture;

void main() {
  float sine = dot(normalize(vec3(direction_xy, 1.0)), frame.up_camera.xyz);
  picture = sine > 0.0 ? frame.sky_horizon + frame.sky_gradient * sine : frame.below_horizon;
}
