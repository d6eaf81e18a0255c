// Light of sun and sky on a matt or slightly glossy surface, as electrons per second.
layout(constant_id = 0) const bool kMono = true;
layout(constant_id = 1) const bool kHighlights = false;

layout(constant_id = 3) const int kCasters = 0;  // how many of the inline casters count; -1: loop over the long list
layout(constant_id = 4) const bool kCylinders = false;

// Does the caster stand between q (camera frame) and the sun? Exact: slabs for boxes, quadratic for cylinders.
bool shades(CasterData c, vec4 q) {
  vec3 o = vec3(dot(c.row0, q), dot(c.row1, q), dot(c.row2, q));
  vec3 d = c.sun_unit.xyz;
  vec3 inverse_d = 1.0 / d;
  vec3 centre = -o * inverse_d;
  vec3 half_width = abs(inverse_d);
  vec3 t0 = centre - half_width;
  vec3 t1 = centre + half_width;
  float enter = max(t0.x, t0.y);
  float leave = min(t1.x, t1.y);
  bool hit = true;
  if (kCylinders && c.sun_unit.w > 0.5) {
    float a = dot(d.xy, d.xy);
    float b = dot(o.xy, d.xy);
    float root2 = b * b - a * (dot(o.xy, o.xy) - 1.0);
    float root = sqrt(max(root2, 0.0));
    enter = (-b - root) / a;
    leave = (-b + root) / a;
    hit = root2 > 0.0;
  }
  return hit && min(leave, t1.z) > max(max(enter, t0.z), 0.0);
}

// The lists hold only what can shade this surface, and never the surface's own (convex) body: no bias is needed.
bool in_shadow(vec3 p) {
  vec4 q = vec4(p, 1.0);
  bool shaded = false;
  if (kCasters < 0) {
    for (uint i = 0u; i < surface.caster_range.y; ++i)
      shaded = shaded || shades(all_casters[caster_list[surface.caster_range.x + i]], q);
  }
  for (int i = 0; i < kCasters; ++i) shaded = shaded || shades(surface.casters[i], q);
  return shaded;
}

vec3 lit(MaterialData m, vec3 n, vec3 p) {
  float cos_sun = dot(n, frame.sun_camera.xyz);
  vec3 rate = m.ambient_0.xyz + m.ambient_1.xyz * dot(n, frame.up_camera.xyz);
  if (cos_sun > 0.0 && !in_shadow(p)) {
    rate += m.sun.xyz * cos_sun;
    if (kHighlights && m.sun.w < 1.0) {
      // GGX with Schlick's Fresnel term for a dielectric, F0 = 0.04, and the height-correlated visibility approximated
      // as 1 / (4 l.h^2) (Lazarov 2011).
      vec3 view = -normalize(p);
      vec3 h = normalize(view + frame.sun_camera.xyz);
      float alpha2 = m.sun.w * m.sun.w * m.sun.w * m.sun.w;
      float nh = max(dot(n, h), 0.0);
      float lh = max(dot(frame.sun_camera.xyz, h), 0.05);
      float f = nh * nh * (alpha2 - 1.0) + 1.0;
      float grazing = 1.0 - lh;
      float fresnel = 0.04 + 0.96 * grazing * grazing * grazing * grazing * grazing;
      rate += frame.sun_specular.xyz * (alpha2 / (3.14159265 * f * f) * fresnel / (4.0 * lh * lh) * cos_sun);
    }
  }
  return rate;
}

// Share of the odd cells of a unit chequered pattern within a box of width w about p (I. Quilez, box-filtered checker).
float checker(vec2 p, vec2 w) {
  vec2 i = 2.0 * (abs(fract((p - 0.5 * w) * 0.5) - 0.5) - abs(fract((p + 0.5 * w) * 0.5) - 0.5)) / w;
  return 0.5 - 0.5 * i.x * i.y;
}

MaterialData mixed(MaterialData a, MaterialData b, float t) {
  MaterialData m;
  m.sun = mix(a.sun, b.sun, t);
  m.ambient_0 = mix(a.ambient_0, b.ambient_0, t);
  m.ambient_1 = mix(a.ambient_1, b.ambient_1, t);
  return m;
}

layout(location = 0) out vec4 picture;

// A mono picture has one channel; the other two must not be worked out.
void put(vec3 rate) { picture = kMono ? vec4(rate.x, 0.0, 0.0, 0.0) : vec4(rate, 0.0); }
