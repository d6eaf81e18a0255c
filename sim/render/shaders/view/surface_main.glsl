#include "sim/render/shaders/view/bindings.glsl"
#include "sim/render/shaders/view/light.glsl"
#include "sim/render/shaders/view/noise.glsl"
#include "sim/render/shaders/view/surface_patch.glsl"
#include "sim/render/shaders/view/surface_light.glsl"
#ifdef NORMALS
#include "sim/render/shaders/view/octahedron.glsl"
layout(location = 2) out uint packed_normal;
#endif
layout(constant_id = 13) const bool kMultisampled = false;
layout(location = 0) out vec4 radiance;
layout(location = 1) out uint node;

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
  Patch s = surface_patch(colour);
  vec3 smooth_normal = flat_normal();
  vec3 normal = smooth_normal;
  if (kNormalMap) normal = bumped(smooth_normal);
  radiance = leaving(s, p, normal, smooth_normal, p);
  node = identity;
#ifdef NORMALS
  packed_normal = packed_direction(normal);
#endif
}
