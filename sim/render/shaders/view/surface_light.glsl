// From what a surface is at a point to the light that leaves it towards the eye. Constants that are off have no code.
layout(constant_id = 7) const bool kHaze = false;
layout(constant_id = 8) const bool kLamps = false;
layout(constant_id = 11) const bool kShadows = false;
layout(constant_id = 5) const bool kTranslucent = false;
layout(constant_id = 6) const bool kWater = false;
layout(constant_id = 12) const bool kGlossy = false;
layout(constant_id = 16) const bool kSkyCover = false;

// `cover_at`: where it is asked what hides the sky, p or a place near it.
vec4 leaving(MaterialSample s, vec3 p, vec3 n, vec3 n_flat, vec3 cover_at) {
  vec3 view = -normalize(p);
  s = weathered(s, p, n);
  s.translucent = kTranslucent;
  s.glossy = kGlossy;
  s.water = kWater;
  // Where things hide a share of the sky, what they let through and throw about takes its place; the ground below is
  // as dark as its surroundings are.
  vec4 open = vec4(1.0);
  if (kSkyCover) open = mix(frame.covered, vec4(1.0), sky_seen(cover_at, n_flat, !kTranslucent));
  vec4 light = lit_all_round(s, sky_irradiance(n) * open, kTranslucent ? sky_irradiance(-n) * open : vec4(0.0));
  if (may_be_lit(s, n, n_flat, frame.sun.xyz)) {
    float seen = kShadows ? sun_seen(p, n_flat) : 1.0;
    light += lit_from(s, view, n, frame.sun.xyz, frame.sun_irradiance * seen);
  }
  if (kGlossy || kWater) {
    Mirror m = mirror(s, view, n);
    vec4 sharp = mix(frame.ground, sky_radiance(m.direction), sky_in_mirror(m.direction));
    light += open * m.share * mix(sky_irradiance(m.direction) / kPi, sharp, m.sharp);
  }
  if (kLamps)
    for (uint i = 0u; i < frame.counts.y; ++i)
      light += lit_by_lamp(s, view, n, frame.lamps[i].position.xyz - p, frame.lamps[i].intensity);
  return kHaze ? through_air(light, p) : light;
}
