#include "sim/render/shaders/view/bindings.glsl"
#include "sim/render/shaders/view/light.glsl"
layout(constant_id = 7) const bool kHaze = false;
layout(location = 0) in vec2 ndc;
layout(location = 0) out vec4 radiance;
layout(location = 1) out uint node;
#ifdef NORMALS
layout(location = 2) out uint packed_normal;
#endif

void main() {
  vec3 d = normalize(frame.ray_0.xyz + frame.ray_x.xyz * ndc.x + frame.ray_y.xyz * ndc.y);
  float pixel = frame.clip_w.w;
  vec4 light = mix(frame.ground, sky_radiance(d), smoothstep(-0.5 * pixel, 0.5 * pixel, d.z));
  if (frame.sun.z > 0.0) light += frame.sun_disc * (disc_share(d, frame.sun.xyz, frame.sun.w, pixel) * step(0.0, d.z));
  if (kHaze) light = through_air(light, d * 1e7);
  radiance = light;
  node = 0u;
#ifdef NORMALS
  packed_normal = 0u;
#endif
}
