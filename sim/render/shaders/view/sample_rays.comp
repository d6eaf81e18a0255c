#version 460
#extension GL_GOOGLE_include_directive : require
// Rays that start at the eye, answered from what range.frag has drawn: identity, material and normal of the texel that
// the ray goes through; its range where the ray meets the plane of the triangle that the texel's middle shows.
//
// A ray through a texel, and no further from its middle than half of it, meets a plane that fills the texel and its
// neighbours between their ranges: 1 / range goes linearly over the view. Where the plane is met elsewhere (a leaf seen
// on edge, the last texel before an edge), no range beyond those of the neighbours of the same thing is believed.
#extension GL_EXT_samplerless_texture_functions : require
#define MAX_HAZES 1
#define MAX_LAMPS 1
#define MAX_CASCADES 1
#include "sim/render/shaders/view/view_structs.glsl.h"
#include "sim/render/shaders/view/octahedron.glsl"
layout(local_size_x = 64) in;
layout(set = 0, binding = 0) uniform utexture2D what;
layout(set = 0, binding = 1) uniform utexture2D place;
layout(set = 0, binding = 2) uniform utexture2D detail;
layout(set = 0, binding = 3) readonly buffer Rays { RayData rays[]; };
layout(set = 0, binding = 4) writeonly buffer Hits { HitData hits[]; };
layout(push_constant) uniform Push {
  vec4 axis;      // direction of texel (0, 0); w: nearest range [m]
  vec4 per_u;     // what a texel to the right adds; w: angle of a texel [rad]
  vec4 per_v;
  uvec4 size;     // width, height [px], first ray, rays
};

vec3 direction(ivec2 t) { return normalize(axis.xyz + per_u.xyz * float(t.x) + per_v.xyz * float(t.y)); }

void main() {
  uint i = gl_GlobalInvocationID.x + gl_GlobalInvocationID.y * 65535u * 64u;
  if (i >= size.w) return;
  i += size.z;
  RayData ray = rays[i];
  HitData hit;
  hit.normal = vec4(0.0);
  hit.what = uvec4(0u);
  hit.rest = vec4(0.0);
  ivec2 last = ivec2(size.xy) - 1;
  ivec2 t = clamp(ivec2(floor(ray.at.xy + 0.5)), ivec2(0), last);
  uvec4 a = texelFetch(what, t, 0);
  if (a.x != 0u) {
    uvec4 b = texelFetch(place, t, 0);
    uvec4 c = texelFetch(detail, t, 0);
    vec3 d = ray.direction.xyz;
    float own = uintBitsToFloat(b.z);
    vec3 plane = from_octahedron(uintBitsToFloat(b.xy));
    float there = dot(plane, direction(t));
    float here = dot(plane, d);
    float range = own;
    if (there * here > 0.0) {
      float met = own * (there / here);
      if (abs(met - own) > own * per_u.w) {
        ivec2 s = ivec2(ray.at.x >= float(t.x) ? 1 : -1, ray.at.y >= float(t.y) ? 1 : -1);
        float low = own;
        float high = own;
        for (int k = 1; k < 4; ++k) {
          ivec2 q = clamp(t + s * ivec2(k & 1, k >> 1), ivec2(0), last);
          if (texelFetch(what, q, 0).x != a.x) continue;
          float other = uintBitsToFloat(texelFetch(place, q, 0).z);
          low = min(low, other);
          high = max(high, other);
        }
        met = clamp(met, low, high);
      }
      range = met;
    }
    if (range >= axis.w && range <= ray.direction.w) {
      vec3 n = from_octahedron(uintBitsToFloat(c.xy));
      hit.normal = vec4(dot(n, d) > 0.0 ? -n : n, range);
      hit.what = uvec4(a.x, a.y, a.w, 0u);
      hit.rest = vec4(uintBitsToFloat(a.z), uintBitsToFloat(b.w), uintBitsToFloat(c.zw));
    }
  }
  hits[i] = hit;
}
