#version 460
#extension GL_GOOGLE_include_directive : require
#include "sim/render/shaders/view/bindings.glsl"
#include "sim/render/shaders/view/instance.glsl"
layout(push_constant) uniform Push { uvec4 cascade; };
layout(location = 0) out vec2 uv;

void main() {
  CascadeData c = frame.cascades[cascade.x];
  vec4 q = vec4(placed(), 1.0);
  uv = in_uv;
  float to_ndc = 2.0 / c.range.z;
  gl_Position = vec4(dot(c.row_x, q) * to_ndc - 1.0, dot(c.row_y, q) * to_ndc - 1.0, dot(c.row_z, q), 1.0);
}
