#version 460
#extension GL_GOOGLE_include_directive : require
#include "sim/render/shaders/view/bindings.glsl"
#include "sim/render/shaders/view/impostor.glsl"
// reflectance: centre, radius [m]
layout(set = 1, binding = 0) uniform SurfaceBlock { SurfaceData surface; };
layout(location = 4) in vec4 row0;
layout(location = 5) in vec4 row1;
layout(location = 6) in vec4 row2;
layout(location = 7) in vec4 tint;
layout(location = 8) in uvec4 extra;
layout(location = 0) out vec3 p;
layout(location = 1) out vec2 uv;
layout(location = 2) flat out vec3 out_tint;
layout(location = 3) flat out uint identity;
layout(location = 4) flat out mat3 to_world;  // of normals
layout(location = 7) flat out uint seed;

void main() {
  vec3 c0 = vec3(row0.x, row1.x, row2.x);
  vec3 c1 = vec3(row0.y, row1.y, row2.y);
  vec3 c2 = vec3(row0.z, row1.z, row2.z);
  vec4 q = vec4(surface.reflectance.xyz, 1.0);
  vec3 centre = vec3(dot(row0, q), dot(row1, q), dot(row2, q));
  vec3 inverse = 1.0 / max(vec3(dot(c0, c0), dot(c1, c1), dot(c2, c2)), vec3(1e-20));
  to_world = mat3(c0 * inverse.x, c1 * inverse.y, c2 * inverse.z);
  // Where the eye stands, seen from the thing: the picture that was taken from nearest there.
  vec3 eye = -vec3(dot(c0, centre), dot(c1, centre), dot(c2, centre)) * sqrt(inverse);
  float azimuth = atan(eye.x, eye.y);
  float elevation = asin(clamp(eye.z / max(length(eye), 1e-6), -1.0, 1.0));
  float column = mod(round(azimuth / 6.2831853 * kColumns), kColumns);
  float row = clamp(round(elevation / kElevationStep), 0.0, kRows - 1.0);
  float a = column * 6.2831853 / kColumns;
  float e = row * kElevationStep;
  vec3 right = vec3(-cos(a), sin(a), 0.0);
  vec3 up = vec3(-sin(a) * sin(e), -cos(a) * sin(e), cos(e));
  vec2 corner = vec2((gl_VertexIndex & 1) == 0 ? -1.0 : 1.0, (gl_VertexIndex & 2) == 0 ? -1.0 : 1.0);
  vec3 offset = (right * corner.x - up * corner.y) * surface.reflectance.w;
  p = centre + c0 * offset.x + c1 * offset.y + c2 * offset.z;
  uv = (vec2(column, row) + 0.5 + 0.5 * corner) / vec2(kColumns, kRows);
  out_tint = tint.xyz;
  identity = extra.x;
  seed = extra.z;
  gl_Position = vec4(dot(frame.clip_x.xyz, p), dot(frame.clip_y.xyz, p), frame.clip_x.w, dot(frame.clip_w.xyz, p));
}
