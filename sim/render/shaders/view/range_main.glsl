// What rays are to find: range, plane, normal and material at the middle of each texel. No light. Maps are asked in
// full, as for a ray and not for a pixel's area.
#define TEXEL(map) textureLod(map, uv, 0.0)
#include "sim/render/shaders/view/bindings.glsl"
#include "sim/render/shaders/view/octahedron.glsl"
#include "sim/render/shaders/view/material_sample.glsl"
layout(push_constant) uniform Push { uvec4 part; };  // number of the surface
// All bits of floats but the first two words and the fourth's halves.
layout(location = 0) out uvec4 what;      // identity, surface, reflectance, halves: transmittance, metallic
layout(location = 1) out uvec4 place;     // normal of the triangle's plane (octahedron), range [m], roughness
layout(location = 2) out uvec4 detail;    // shading normal (octahedron), texture coordinate

void main() {
  vec4 colour = vec4(1.0);
  if (kColourMap) colour = TEXEL(colour_map);
#ifdef ALPHA
  if (colour.a < surface.gloss.z) discard;
#endif
  vec3 normal = shading_normal();
  if (kNormalMap) normal = normal_mapped(normal);
  MaterialSample s = weathered(material_sample(colour), p, normal);
  vec3 plane = cross(dFdx(p), dFdy(p));
  float area = dot(plane, plane);
  plane = area > 0.0 ? plane * inversesqrt(area) : normal;
  what = uvec4(identity, part.x, floatBitsToUint(s.reflectance.x), packHalf2x16(vec2(s.transmittance.x, s.metallic)));
  place = uvec4(floatBitsToUint(to_octahedron(plane)), floatBitsToUint(length(p)), floatBitsToUint(s.roughness));
  detail = uvec4(floatBitsToUint(to_octahedron(normal)), floatBitsToUint(uv));
}
