#version 460
#extension GL_GOOGLE_include_directive : require
#define MAX_HAZES 1
#define MAX_LAMPS 1
#define MAX_CASCADES 1
#include "sim/render/shaders/view/view_structs.glsl.h"
layout(constant_id = 0) const bool kColourMap = false;
layout(constant_id = 1) const bool kNearInfraredMap = false;
layout(constant_id = 4) const bool kAlpha = false;
layout(constant_id = 14) const bool kTwoSided = false;
layout(push_constant) uniform Push {
  vec4 row_x;
  vec4 row_y;
  vec4 row_z;
  vec4 reflectance;
  vec4 near_infrared;
};
layout(set = 1, binding = 0) uniform SurfaceBlock { SurfaceData surface; };
layout(set = 1, binding = 1) uniform sampler2D colour_map;
layout(set = 1, binding = 2) uniform sampler2D near_infrared_map;
layout(location = 0) in vec3 n;
layout(location = 1) in vec2 uv;
// Square roots, as dark tones need the finer steps.
layout(location = 0) out vec4 visible;  // w: coverage
layout(location = 1) out vec4 infrared; // w: transmittance over reflectance
layout(location = 2) out vec4 normal;

void main() {
  vec4 colour = vec4(1.0);
  if (kColourMap) colour = texture(colour_map, uv);
  if (kAlpha && colour.a < surface.gloss.z) discard;
  vec3 nir = vec3(dot(colour.rgb, vec3(1.0 / 3.0)));
  if (kNearInfraredMap) nir = texture(near_infrared_map, uv).rgb;
  vec3 toward = -row_z.xyz;
  vec3 m = normalize(n);
  if (kTwoSided && dot(m, toward) < 0.0) m = -m;
  visible = vec4(sqrt(clamp(reflectance.rgb * colour.rgb, 0.0, 1.0)), 1.0);
  infrared = vec4(sqrt(clamp(near_infrared.rgb * nir, 0.0, 1.0)), near_infrared.w);
  normal = vec4(m * 0.5 + 0.5, surface.flags.x);
}
