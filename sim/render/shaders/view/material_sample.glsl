// What a mesh's fragment gets from its vertices and its maps. TEXEL: how a map is asked at a texture coordinate.
#include "sim/render/shaders/view/material.glsl"
#ifndef TEXEL
#define TEXEL(map) texture(map, uv)
#endif
layout(constant_id = 0) const bool kColourMap = false;
layout(constant_id = 1) const bool kNearInfraredMap = false;
layout(constant_id = 2) const bool kNormalMap = false;
layout(constant_id = 3) const bool kGlossMap = false;
layout(constant_id = 14) const bool kTwoSided = false;
layout(set = 1, binding = 0) uniform SurfaceBlock { SurfaceData surface; };
layout(set = 1, binding = 1) uniform sampler2D colour_map;
layout(set = 1, binding = 2) uniform sampler2D near_infrared_map;
layout(set = 1, binding = 3) uniform sampler2D normal_map;
layout(set = 1, binding = 4) uniform sampler2D gloss_map;
layout(location = 0) in vec3 p;
layout(location = 1) in vec3 n;
layout(location = 2) in vec2 uv;
layout(location = 3) flat in vec3 tint;
layout(location = 4) flat in uint identity;
layout(location = 5) flat in uint seed;

// The normal map's direction in a frame made of how place and texture coordinate change over the picture
// (Mikkelsen 2010): x along growing u, y against growing v (towards the map's top).
vec3 normal_mapped(vec3 normal) {
  vec3 m = TEXEL(normal_map).xyz * 2.0 - 1.0;
  vec3 px = dFdx(p);
  vec3 py = dFdy(p);
  vec2 tx = dFdx(uv);
  vec2 ty = dFdy(uv);
  vec3 a = cross(py, normal);
  vec3 b = cross(normal, px);
  vec3 t = a * tx.x + b * ty.x;
  vec3 u = a * tx.y + b * ty.y;
  float longest = max(dot(t, t), dot(u, u));
  if (!(longest > 0.0)) return normal;
  // The picture's y points down: seen from outside, its axes and the normal are left-handed.
  float scale = inversesqrt(longest) * (dot(px, a) < 0.0 ? -1.0 : 1.0);
  return normalize(t * (scale * m.x) - u * (scale * m.y) + normal * max(m.z, 0.05));
}

// Before the weather.
MaterialSample material_sample(vec4 colour) {
  MaterialSample s;
  vec4 factor = vec4(1.0);
  if (kColourMap || kNearInfraredMap)
    factor = surface.colour_to_band[0] * colour.r + surface.colour_to_band[1] * colour.g +
             surface.colour_to_band[2] * colour.b;
  if (kNearInfraredMap) {
    vec3 nir = TEXEL(near_infrared_map).rgb;
    factor += surface.near_infrared_to_band[0] * nir.r + surface.near_infrared_to_band[1] * nir.g +
              surface.near_infrared_to_band[2] * nir.b;
  }
  factor *= frame.tint_to_band[0] * tint.r + frame.tint_to_band[1] * tint.g + frame.tint_to_band[2] * tint.b;
  s.reflectance = surface.reflectance * factor;
  s.transmittance = surface.transmittance * factor;
  s.roughness = surface.gloss.x;
  if (kGlossMap) s.roughness *= 1.0 - 0.95 * TEXEL(gloss_map).r;
  s.metallic = surface.gloss.y;
  s.porosity = surface.gloss.w;
  s.takes_snow = surface.flags.x;
  s.retro_reflection = surface.flags.y;
  s.translucent = s.glossy = s.water = false;  // told by the shader's features
  return s;
}

// Of the side that is seen, without the map.
vec3 shading_normal() {
  vec3 m = normalize(n);
  return kTwoSided && !gl_FrontFacing ? -m : m;
}
