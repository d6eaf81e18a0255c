#include "sim/render/shaders/view/bindings.glsl"
#include "sim/render/shaders/view/light.glsl"
#include "sim/render/shaders/view/material_sample.glsl"
#include "sim/render/shaders/view/surface_light.glsl"
#ifdef ALPHA
#include "sim/render/shaders/view/holes.glsl"
#endif
#ifdef NORMALS
#include "sim/render/shaders/view/octahedron.glsl"
layout(location = 2) out uint packed_normal;
#endif
layout(location = 0) out vec4 radiance;
layout(location = 1) out uint node;

void main() {
  vec4 colour = vec4(1.0);
  if (kColourMap) colour = texture(colour_map, uv);
#ifdef ALPHA
  cut_holes(colour.a, surface.gloss.z, seed);
#endif
  MaterialSample s = material_sample(colour);
  vec3 smooth_normal = shading_normal();
  vec3 normal = smooth_normal;
  if (kNormalMap) normal = normal_mapped(smooth_normal);
  radiance = leaving(s, p, normal, smooth_normal, p);
  node = identity;
#ifdef NORMALS
  packed_normal = packed_direction(normal);
#endif
}
