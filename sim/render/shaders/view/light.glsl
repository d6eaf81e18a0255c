// Light of sun and sky, what hides them, and the air on its way to the eye.
#include "sim/render/shaders/shading.glsl.h"

vec4 sky_irradiance(vec3 n) {
  vec4 e = frame.sky_light[0] + frame.sky_light[1] * n.y + frame.sky_light[2] * n.z + frame.sky_light[3] * n.x +
           frame.sky_light[4] * (n.x * n.y) + frame.sky_light[5] * (n.y * n.z) +
           frame.sky_light[6] * (3.0 * n.z * n.z - 1.0) + frame.sky_light[7] * (n.x * n.z) +
           frame.sky_light[8] * (n.x * n.x - n.y * n.y);
  return max(e, vec4(0.0));
}

// Below the horizon: the horizon.
vec4 sky_radiance(vec3 d) {
  float azimuth = atan(d.x, d.y);
  float elevation = asin(clamp(d.z, 0.0, 1.0));
  return textureLod(sky_map, vec2(azimuth / (2.0 * kPi), elevation / (0.5 * kPi)), 0.0) * frame.weather.z;
}

vec4 through_air(vec4 radiance, vec3 p) {
  vec4 depth = vec4(0.0);
  vec4 source = vec4(0.0);
  for (uint i = 0u; i < frame.counts.x; ++i) {
    vec4 tau = frame.hazes[i].extinction * (length(p) * share_below(frame.hazes[i].top.x, 0.0, p.z));
    depth += tau;
    source += tau * frame.hazes[i].inscatter;
  }
  return behind_air(radiance, depth, source);
}

float texel_lit(ivec2 at, int layer, float z) { return texelFetch(shadow_map, ivec3(at, layer), 0).x >= z ? 1.0 : 0.0; }

// How much of the sun is seen from p on a surface with normal n (both as drawn).
float sun_seen(vec3 p, vec3 n) {
  float depth = dot(frame.clip_w.xyz, p);
  int c = 0;
  while (c < int(frame.counts.z) && depth > frame.cascades[c].range.x) ++c;
  if (c == int(frame.counts.z)) return 1.0;
  float cos_sun = abs(dot(n, frame.sun.xyz));
  // Off the surface by what a texel and its neighbours can differ in height, seen from the sun.
  float sin_sun = sqrt(max(1.0 - cos_sun * cos_sun, 0.0));
  vec3 side = dot(n, frame.sun.xyz) < 0.0 ? -n : n;
  vec4 q = vec4(p + side * (frame.cascades[c].range.y * (0.2 + 1.3 * sin_sun)), 1.0);
  vec2 uv = vec2(dot(frame.cascades[c].row_x, q), dot(frame.cascades[c].row_y, q));
  float z = dot(frame.cascades[c].row_z, q) - 0.1 * frame.cascades[c].range.y / frame.cascades[c].range.w;
  vec2 base = floor(uv - 0.5);
  vec2 f = uv - 0.5 - base;
  // Two by two texels, blended between neighbours: nine texels.
  ivec2 last = ivec2(frame.cascades[c].range.z - 1.0);
  ivec2 at = ivec2(f.x < 0.5 ? base.x - 1.0 : base.x, f.y < 0.5 ? base.y - 1.0 : base.y);
  vec2 g = vec2(f.x < 0.5 ? f.x + 0.5 : f.x - 0.5, f.y < 0.5 ? f.y + 0.5 : f.y - 0.5);
  vec3 wx = vec3(1.0 - g.x, 1.0, g.x);
  vec3 wy = vec3(1.0 - g.y, 1.0, g.y);
  float lit = 0.0;
  for (int j = 0; j < 3; ++j)
    for (int i = 0; i < 3; ++i)
      lit += wx[i] * wy[j] * texel_lit(clamp(at + ivec2(i, j), ivec2(0), last), c, z);
  return 0.25 * lit;
}

// How much of the upper sky a point sees, weighted by the cosine to the zenith as on level ground, 0 to 1; as a share of
// what its surface would see in the open (`sided`), or of all the sky (a leaf, lit on both sides). From the map of what
// covers the ground: along eight azimuths (for leaves four) the highest horizon of three places, each thing taken to
// reach down to the ground; the sky above a horizon h gives cos^2 h. Places and pattern stand still in the world. Thin
// walls between the places are missed; beyond the map's edge all is open.
float sky_seen(vec3 p, vec3 n, bool sided) {
  const CascadeData c = frame.cascades[MAX_CASCADES - 1];
  const float radii[3] = float[3](0.8, 3.2, 13.0);
  vec4 q = vec4(p, 1.0);
  // Off a wall, whose own top would else cover it.
  if (sided) q.xy += n.xy * (2.0 * c.range.y);
  vec2 uv = vec2(dot(c.row_x, q), dot(c.row_y, q));
  ivec2 last = ivec2(c.range.z - 1.0);
  float z = dot(c.row_z, q) - 0.15 / c.range.w;
  float known = clamp((c.range.x - max(abs(p.x), abs(p.y))) / 24.0, 0.0, 1.0);
  if (known == 0.0) return 1.0;
  float open = 0.0;
  float most = 0.0;
  vec2 along = vec2(0.92387953, 0.38268343);
  vec2 turn = sided ? vec2(0.70710678) : vec2(0.0, 1.0);
  for (int a = 0; a < 8; a += sided ? 1 : 2) {
    // The surface's own plane: what lies below it gives it no light. The map's second axis points south.
    float own = sided ? max(-(n.x * along.x - n.y * along.y) / max(n.z, 0.05), 0.0) : 0.0;
    float horizon = own;
    for (int k = 0; k < 3; ++k) {
      ivec2 at = clamp(ivec2(uv + along * (radii[k] / c.range.y)), ivec2(0), last);
      horizon = max(horizon, (z - texelFetch(zenith_map, at, 0).x) * (c.range.w / radii[k]));
    }
    open += 1.0 / (1.0 + horizon * horizon);
    most += 1.0 / (1.0 + own * own);
    along = vec2(along.x * turn.x - along.y * turn.y, along.x * turn.y + along.y * turn.x);
  }
  return mix(1.0, open / most, known);
}
