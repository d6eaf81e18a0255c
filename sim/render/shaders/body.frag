#version 460
#extension GL_GOOGLE_include_directive : require
#include "sim/render/shaders/bindings.glsl"
#include "sim/render/shaders/shading.glsl"
layout(location = 0) in vec3 p_camera;
layout(location = 1) in vec3 n_camera;
layout(location = 2) in vec3 p_body;
layout(location = 3) in vec3 n_body;
layout(constant_id = 2) const bool kPattern = false;  // a chessboard on the +z face

void main() {
  MaterialData m = surface.material;
  if (kPattern) {
    vec2 q = p_body.xy * surface.pattern.z;  // in squares from the centre
    vec2 w = max(max(abs(dFdx(q)), abs(dFdy(q))), vec2(1e-4));
    // The board's outer edge, box-filtered too: the share of the pixel that lies on the board, times the mean of the
    // squares there.
    vec2 half_board = 0.5 * surface.pattern.xy;
    vec2 inside = clamp((half_board - abs(q)) / w + 0.5, 0.0, 1.0);
    vec2 room = max(half_board - 0.5 * w, vec2(0.0));
    float dark = checker(clamp(q, -room, room) + half_board, w) * inside.x * inside.y;
    m = mixed(m, surface.other, n_body.z > 0.5 ? dark : 0.0);
  }
  put(lit(m, normalize(n_camera), p_camera));
}
