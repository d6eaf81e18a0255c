// Directions on the faces of an octahedron (Meyer et al. 2010): two numbers from -1 to 1 for a unit vector.
vec2 to_octahedron(vec3 n) {
  vec2 q = n.xy / max(abs(n.x) + abs(n.y) + abs(n.z), 1e-30);
  vec2 sides = vec2(q.x >= 0.0 ? 1.0 : -1.0, q.y >= 0.0 ? 1.0 : -1.0);
  return n.z >= 0.0 ? q : (1.0 - abs(q.yx)) * sides;
}
vec3 from_octahedron(vec2 q) {
  vec3 n = vec3(q, 1.0 - abs(q.x) - abs(q.y));
  if (n.z < 0.0) n.xy = (1.0 - abs(n.yx)) * vec2(n.x >= 0.0 ? 1.0 : -1.0, n.y >= 0.0 ? 1.0 : -1.0);
  return normalize(n);
}
// In 32 bits, within 6e-5 rad. Never 0.
uint packed_direction(vec3 n) {
  uint bits = packSnorm2x16(to_octahedron(n));
  return bits == 0u ? 1u : bits;
}
