#version 460
#extension GL_GOOGLE_include_directive : require
#include "sim/render/shaders/bindings.glsl"
layout(location = 0) out vec2 direction_xy;

// One triangle over the whole picture at infinite depth (0 where depth is reversed).
void main() {
  vec2 ndc = vec2(gl_VertexIndex == 1 ? 3.0 : -1.0, gl_VertexIndex == 2 ? 3.0 : -1.0);
  direction_xy = vec2((ndc.x - frame.projection.y) / frame.projection.x, (ndc.y - frame.projection.w) / frame.projection.z);
  gl_Position = vec4(ndc, 0.0, 1.0);
}
