#version 460
#extension GL_GOOGLE_include_directive : require
#include "sim/render/shaders/view/bindings.glsl"
#include "sim/render/shaders/view/instance.glsl"
layout(location = 0) out vec3 p;
layout(location = 1) out vec3 n;
layout(location = 2) out vec2 uv;
layout(location = 3) flat out vec3 out_tint;
layout(location = 4) flat out uint identity;
layout(location = 5) flat out uint seed;
invariant gl_Position;  // drawn twice: depth first, then light where the depth is the same

void main() {
  p = placed();
  n = placed_normal();
  uv = in_uv;
  out_tint = tint.xyz;
  identity = extra.x;
  seed = extra.z;
  gl_Position = vec4(dot(frame.clip_x.xyz, p), dot(frame.clip_y.xyz, p), frame.clip_x.w, dot(frame.clip_w.xyz, p));
}
