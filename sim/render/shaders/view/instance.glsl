// A vertex of an instance, relative to the eye; of a caster, to the middle of its shadow map.
layout(location = 0) in vec3 in_position;
layout(location = 1) in vec3 in_normal;
layout(location = 2) in vec2 in_uv;
layout(location = 3) in float in_sway;
layout(location = 4) in vec4 row0;
layout(location = 5) in vec4 row1;
layout(location = 6) in vec4 row2;
layout(location = 7) in vec4 tint;
layout(location = 8) in uvec4 extra;
layout(constant_id = 15) const bool kSway = false;

vec3 placed() {
  vec4 q = vec4(in_position, 1.0);
  vec3 p = vec3(dot(row0, q), dot(row1, q), dot(row2, q));
  if (kSway) {
    float way = in_sway * uintBitsToFloat(extra.y);
    // Slow bending down the wind and fast flutter across it.
    float slow = 0.7 + 0.3 * sin(frame.gust.x + tint.w);
    float fast = 0.12 * sin(frame.gust.y + 2.0 * tint.w + 7.0 * (in_position.x + in_position.y + in_position.z));
    p += way * (frame.wind.xyz * slow + vec3(-frame.wind.y, frame.wind.x, 0.4 * length(frame.wind.xy)) * fast);
  }
  return p;
}

vec3 placed_normal() {
  // Inverse transpose of rotation times scale: each column over its squared length.
  vec3 c0 = vec3(row0.x, row1.x, row2.x);
  vec3 c1 = vec3(row0.y, row1.y, row2.y);
  vec3 c2 = vec3(row0.z, row1.z, row2.z);
  return c0 * (in_normal.x / max(dot(c0, c0), 1e-20)) + c1 * (in_normal.y / max(dot(c1, c1), 1e-20)) +
         c2 * (in_normal.z / max(dot(c2, c2), 1e-20));
}
