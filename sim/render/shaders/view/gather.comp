#version 460
#extension GL_GOOGLE_include_directive : require
// Instances that are drawn, from where they lie in their batches to a list in the order of drawing.
#define MAX_HAZES 1
#define MAX_LAMPS 1
#define MAX_CASCADES 1
#include "sim/render/shaders/view/view_structs.glsl.h"
layout(local_size_x = 64) in;
layout(set = 0, binding = 0) readonly buffer Instances { InstanceData instances[]; };
layout(set = 0, binding = 1) readonly buffer Entries { DrawEntry entries[]; };
layout(set = 0, binding = 2) writeonly buffer Drawn { DrawnInstance drawn[]; };
layout(push_constant) uniform Push { uvec4 range; };  // first entry, number

void main() {
  uint i = gl_GlobalInvocationID.x + gl_GlobalInvocationID.y * 65535u * 64u;
  if (i >= range.y) return;
  DrawEntry e = entries[range.x + i];
  InstanceData a = instances[e.slot.x];
  vec4 q = a.rotation;
  vec3 s = a.scale.xyz;
  vec3 t = e.origin.xyz + a.position.xyz;
  DrawnInstance d;
  d.row0 = vec4((1.0 - 2.0 * (q.y * q.y + q.z * q.z)) * s.x, 2.0 * (q.x * q.y - q.w * q.z) * s.y,
                2.0 * (q.x * q.z + q.w * q.y) * s.z, t.x);
  d.row1 = vec4(2.0 * (q.x * q.y + q.w * q.z) * s.x, (1.0 - 2.0 * (q.x * q.x + q.z * q.z)) * s.y,
                2.0 * (q.y * q.z - q.w * q.x) * s.z, t.y);
  d.row2 = vec4(2.0 * (q.x * q.z - q.w * q.y) * s.x, 2.0 * (q.y * q.z + q.w * q.x) * s.y,
                (1.0 - 2.0 * (q.x * q.x + q.y * q.y)) * s.z, t.z);
  d.tint = vec4(a.tint.xyz, a.position.w);
  d.extra = uvec4(e.slot.z, floatBitsToUint(a.scale.w), e.slot.w, 0u);
  drawn[e.slot.y] = d;
}
