#version 460
#extension GL_GOOGLE_include_directive : require
#include "sim/render/shaders/bindings.glsl"
#include "sim/render/shaders/shading.glsl"
layout(location = 0) in vec3 p_camera;
layout(location = 1) in vec3 n_camera;
layout(location = 2) in vec3 p_body;
layout(location = 3) in vec3 n_body;
layout(location = 4) flat in uint body_index;

void main() {
  BodyData b = bodies[body_index];
  MaterialData m = materials[b.surface.x];
  if (b.board.x > 0.5) {
    vec2 q = p_body.xy * b.board.z;  // in squares from the centre
    vec2 w = max(max(abs(dFdx(q)), abs(dFdy(q))), vec2(1e-4));
    // The board's outer edge, box-filtered too; even numbers of squares have a corner at the centre.
    vec2 inside = clamp((0.5 * b.board.xy - abs(q)) / w + 0.5, 0.0, 1.0);
    float dark = checker(q + 0.5 * b.board.xy, w) * inside.x * inside.y;
    if (n_body.z > 0.5) m = mixed(m, materials[b.surface.y], dark);
  }
  put(lit(m, normalize(n_camera), p_camera, b.surface.z, b.surface.w));
}
