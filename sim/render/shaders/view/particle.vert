#version 460
#extension GL_GOOGLE_include_directive : require
#include "sim/render/shaders/view/bindings.glsl"
layout(location = 4) in vec4 head;
layout(location = 5) in vec4 tail;
layout(location = 0) out vec2 across;
layout(location = 1) flat out float covers;
layout(location = 2) out vec3 p;

void main() {
  vec3 along = head.xyz - tail.xyz;
  float r = 0.5 * head.w;
  vec3 view = normalize(head.xyz);
  vec3 side = cross(view, along);
  float l = length(side);
  side = l > 1e-6 ? side / l : normalize(cross(view, abs(view.z) < 0.9 ? vec3(0, 0, 1) : vec3(1, 0, 0)));
  vec3 up = cross(side, view);
  float s = (gl_VertexIndex & 1) == 0 ? -1.0 : 1.0;
  float e = (gl_VertexIndex & 2) == 0 ? -1.0 : 1.0;
  p = (e > 0.0 ? head.xyz : tail.xyz) + side * (s * r) + up * (e * r);
  across = vec2(s, e);
  covers = tail.w;
  gl_Position = vec4(dot(frame.clip_x.xyz, p), dot(frame.clip_y.xyz, p), frame.clip_x.w, dot(frame.clip_w.xyz, p));
}
