#version 460
#extension GL_GOOGLE_include_directive : require
#include "sim/render/shaders/view/bindings.glsl"
#include "sim/render/shaders/view/instance.glsl"
layout(push_constant) uniform Push { uvec4 cascade; };  // its number, bits of where depth begins
layout(location = 0) out vec2 uv;

// Instances lie relative to the map's middle.
void main() {
  CascadeData c = frame.cascades[cascade.x];
  vec3 p = placed();
  uv = in_uv;
  vec2 at = vec2(dot(c.row_x.xyz, p), dot(c.row_y.xyz, p)) * (2.0 / c.range.z);
  gl_Position = vec4(at, dot(c.row_z.xyz, p) + uintBitsToFloat(cascade.y), 1.0);
}
