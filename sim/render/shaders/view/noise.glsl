// Smooth noise that stands still in the world: cells of 1 m, period 1024 m.
uint pcg(uint v) {
  uint state = v * 747796405u + 2891336453u;
  uint word = ((state >> ((state >> 28u) + 4u)) ^ state) * 277803737u;
  return (word >> 22u) ^ word;
}
float corner(ivec3 cell) {
  uvec3 c = uvec3(cell) & 1023u;
  return float(pcg(c.x + 1024u * c.y + 1048576u * c.z) >> 8u) / 16777216.0;
}
float smooth_noise(vec3 p) {
  vec3 base = floor(p);
  vec3 f = p - base;
  f = f * f * (3.0 - 2.0 * f);
  ivec3 c = ivec3(base);
  vec4 low = vec4(corner(c), corner(c + ivec3(1, 0, 0)), corner(c + ivec3(0, 1, 0)), corner(c + ivec3(1, 1, 0)));
  vec4 high = vec4(corner(c + ivec3(0, 0, 1)), corner(c + ivec3(1, 0, 1)), corner(c + ivec3(0, 1, 1)),
                   corner(c + ivec3(1, 1, 1)));
  vec4 z = mix(low, high, f.z);
  vec2 y = mix(z.xy, z.zw, f.y);
  return mix(y.x, y.y, f.x);
}
