#version 460
#extension GL_GOOGLE_include_directive : require
#include "sim/render/shaders/bindings.glsl"
#include "sim/render/shaders/shading.glsl"
layout(location = 0) in vec3 p_camera;
layout(location = 1) in vec2 cells;
layout(location = 2) flat in ivec2 base;
layout(constant_id = 2) const bool kPattern = false;  // smooth noise

float lattice(ivec2 cell) {
  uint h = uint(cell.x) * 0x9E3779B1u ^ uint(cell.y) * 0x85EBCA77u;
  h = (h ^ (h >> 15)) * 0x2C1B3C6Du;
  h = (h ^ (h >> 12)) * 0x297A2D39u;
  return float((h ^ (h >> 15)) >> 8) * (1.0 / 16777216.0);
}

// Smooth noise in [0, 1] on a lattice that is anchored in the ground's frame through the tile's integer base.
float smooth_noise(vec2 p, ivec2 first) {
  vec2 corner = floor(p);
  vec2 f = p - corner;
  f = f * f * (3.0 - 2.0 * f);
  ivec2 c = first + ivec2(corner);
  return mix(mix(lattice(c), lattice(c + ivec2(1, 0)), f.x), mix(lattice(c + ivec2(0, 1)), lattice(c + ivec2(1, 1)), f.x),
             f.y);
}

void main() {
  vec2 w = max(max(abs(dFdx(cells)), abs(dFdy(cells))), vec2(1e-4));
  MaterialData m = mixed(surface.material, surface.other, checker(cells, w));
  vec3 rate = lit(m, frame.up_camera.xyz, p_camera);
  if (kPattern) {
    float per_cell = surface.pattern.y;
    // Noise finer than a pixel averages out to its mean.
    float visible = clamp(1.5 - max(w.x, w.y) * per_cell, 0.0, 1.0);
    float n = mix(0.5, smooth_noise(cells * per_cell, base * int(per_cell)), visible);
    rate *= 1.0 - surface.pattern.x * n;
  }
  put(rate);
}
