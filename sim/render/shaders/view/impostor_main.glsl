#include "sim/render/shaders/view/bindings.glsl"
#include "sim/render/shaders/view/light.glsl"
#include "sim/render/shaders/view/material.glsl"
#include "sim/render/shaders/view/surface_light.glsl"
layout(constant_id = 13) const bool kMultisampled = false;
layout(set = 1, binding = 0) uniform SurfaceBlock { SurfaceData surface; };
layout(set = 1, binding = 1) uniform sampler2D visible_map;
layout(set = 1, binding = 2) uniform sampler2D infrared_map;
layout(set = 1, binding = 3) uniform sampler2D normal_map;
layout(location = 0) in vec3 p;
layout(location = 1) in vec2 uv;
layout(location = 2) flat in vec3 tint;
layout(location = 3) flat in uint identity;
layout(location = 4) flat in mat3 to_world;
layout(location = 7) flat in uint seed;
layout(location = 0) out vec4 radiance;
layout(location = 1) out uint node;
#ifdef NORMALS
#include "sim/render/shaders/view/octahedron.glsl"
layout(location = 2) out uint packed_normal;
#endif

void main() {
  vec4 visible = texture(visible_map, uv);
  float covered = visible.a;
  uint turn = pcg(uint(gl_FragCoord.x) + (uint(gl_FragCoord.y) << 16u) + seed);
  gl_SampleMask[0] = 15;
  if (kMultisampled) {
    // Thin twigs cover a part of a texel: samples by that part, the rounding differing from pixel to pixel.
    int count = int(covered * 4.0 + float(turn >> 16u) / 65536.0);
    if (count == 0) discard;
    uint bits = ((1u << min(count, 4)) - 1u) * 17u;
    gl_SampleMask[0] = int((bits >> (turn & 3u)) & 15u);
  } else if (covered < 0.5) {
    discard;
  }
  // The maps hold nothing where nothing is: what was averaged counts by its coverage.
  vec3 colour = visible.rgb / covered;
  vec4 infrared = texture(infrared_map, uv) / covered;
  vec4 n = texture(normal_map, uv) / covered;
  colour *= colour;
  infrared.rgb *= infrared.rgb;
  vec4 factor = frame.tint_to_band[0] * tint.r + frame.tint_to_band[1] * tint.g + frame.tint_to_band[2] * tint.b;
  MaterialSample s;
  s.reflectance = surface.colour_to_band[0] * colour.r + surface.colour_to_band[1] * colour.g +
                  surface.colour_to_band[2] * colour.b + surface.near_infrared_to_band[0] * infrared.r +
                  surface.near_infrared_to_band[1] * infrared.g + surface.near_infrared_to_band[2] * infrared.b;
  s.reflectance *= factor;
  s.transmittance = s.reflectance * infrared.a;
  s.roughness = 1.0;
  s.metallic = 0.0;
  s.porosity = 0.5;
  s.takes_snow = n.w;
  s.retro_reflection = 0.0;
  s.translucent = s.glossy = s.water = false;
  vec3 m = to_world * (n.xyz * 2.0 - 1.0);
  m = dot(m, m) > 1e-8 ? normalize(m) : normalize(-p);
  // The picture stands in the thing's middle; what is seen lies nearer.
  float scale = 1.0 / max(length(to_world[0]), 1e-6);
  vec3 nearer = p - normalize(vec3(p.xy, 1e-6)) * (0.5 * surface.reflectance.w * scale);
  radiance = leaving(s, p, m, m, nearer);
  node = identity;
#ifdef NORMALS
  packed_normal = packed_direction(m);
#endif
}
