#include "sim/render/shaders/view/bindings.glsl"
#include "sim/render/shaders/view/light.glsl"
#include "sim/render/shaders/view/noise.glsl"
#include "sim/render/shaders/view/surface_light.glsl"
layout(constant_id = 0) const bool kColourMap = false;
layout(constant_id = 1) const bool kNearInfraredMap = false;
layout(constant_id = 2) const bool kNormalMap = false;
layout(constant_id = 3) const bool kGlossMap = false;
layout(constant_id = 13) const bool kMultisampled = false;
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
layout(location = 0) out vec4 radiance;
layout(location = 1) out uint node;

// The normal map's direction in a frame made of how place and texture coordinate change over the picture
// (Mikkelsen 2010).
vec3 bumped(vec3 normal) {
  vec3 m = texture(normal_map, uv).xyz * 2.0 - 1.0;
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
  float scale = inversesqrt(longest);
  return normalize(t * (scale * m.x) + u * (scale * m.y) + normal * max(m.z, 0.05));
}

void main() {
  vec4 colour = vec4(1.0);
  if (kColourMap) colour = texture(colour_map, uv);
#ifdef ALPHA
  float cutoff = surface.gloss.z;
  gl_SampleMask[0] = 15;
  if (kMultisampled) {
    // Coverage by sample: as sharp as a pixel, round the cutoff. Which samples come first differs from pixel to pixel
    // and from instance to instance, so that leaves behind each other do not hide each other exactly.
    float covered = clamp((colour.a - cutoff) / max(fwidth(colour.a), 1e-4) + 0.5, 0.0, 1.0);
    int count = int(covered * 4.0 + 0.5);
    if (count == 0) discard;
    uint turn = pcg(uint(gl_FragCoord.x) + (uint(gl_FragCoord.y) << 16u) + seed) & 3u;
    uint bits = ((1u << count) - 1u) * 17u;
    gl_SampleMask[0] = int((bits >> turn) & 15u);
  } else if (colour.a < cutoff) {
    discard;
  }
#endif
  Patch s;
  vec4 factor = vec4(1.0);
  if (kColourMap || kNearInfraredMap)
    factor = surface.colour_to_band[0] * colour.r + surface.colour_to_band[1] * colour.g +
             surface.colour_to_band[2] * colour.b;
  if (kNearInfraredMap) {
    vec3 nir = texture(near_infrared_map, uv).rgb;
    factor += surface.near_infrared_to_band[0] * nir.r + surface.near_infrared_to_band[1] * nir.g +
              surface.near_infrared_to_band[2] * nir.b;
  }
  factor *= frame.tint_to_band[0] * tint.r + frame.tint_to_band[1] * tint.g + frame.tint_to_band[2] * tint.b;
  s.reflectance = surface.reflectance * factor;
  s.transmittance = surface.transmittance * factor;
  s.roughness = surface.gloss.x;
  if (kGlossMap) s.roughness *= 1.0 - 0.95 * texture(gloss_map, uv).r;
  s.metallic = surface.gloss.y;
  s.porosity = surface.gloss.w;
  s.takes_snow = surface.flags.x;
  vec3 flat_normal = normalize(n);
  if (kTwoSided && !gl_FrontFacing) flat_normal = -flat_normal;
  vec3 normal = flat_normal;
  if (kNormalMap) normal = bumped(flat_normal);
  radiance = leaving(s, p, normal, flat_normal, p);
  node = identity;
}
