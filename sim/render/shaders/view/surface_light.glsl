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
  float cos_sun = dot(n, frame.sun.xyz);
  float cos_flat = dot(n_flat, frame.sun.xyz);
  vec4 sun = vec4(0.0);
  // A face turned away from the sun is dark whatever its bumps say; a leaf may be lit through.
  if (cos_sun * cos_flat > 0.0 && (kTranslucent || cos_sun > 0.0)) {
    sun = frame.sun_irradiance;
    if (kShadows) sun *= sun_seen(p, n_flat);
  }
  vec4 diffuse = s.reflectance;
  if (kGlossy) diffuse *= 1.0 - s.metallic;
  // Where things hide a share of the sky, what they let through and throw about takes its place; the ground below is
  // as dark as its surroundings are.
  vec4 open = vec4(1.0);
  if (kSkyCover) open = mix(frame.covered, vec4(1.0), sky_seen(cover_at, n_flat, !kTranslucent));
  vec4 light = diffuse / kPi * (sun * max(cos_sun, 0.0) + sky_irradiance(n) * open);
  if (kTranslucent)
    light += s.transmittance / kPi * (sun * max(-cos_sun, 0.0) + sky_irradiance(-n) * open);
  if (kGlossy || kWater) {
    vec4 f0 = kWater ? vec4(0.02) : mix(vec4(0.04), s.reflectance, s.metallic);
    if (cos_sun > 0.0) light += highlight(n, view, frame.sun.xyz, s.roughness, f0) * sun * cos_sun;
    // The sky's mirror image, the blurrier the rougher; the mean over the lobe of a rough one is weak.
    float grazing = 1.0 - clamp(dot(n, view), 0.0, 1.0);
    float grazing2 = grazing * grazing;
    vec4 fresnel = f0 + (max(vec4(1.0 - s.roughness), f0) - f0) * grazing2 * grazing2 * grazing;
    vec3 mirrored = reflect(-view, n);
    if (kWater) mirrored.z = abs(mirrored.z);
    vec4 blurred = sky_irradiance(mirrored) / kPi;
    vec4 sharp = mix(frame.ground, sky_radiance(mirrored), smoothstep(-0.1, 0.05, mirrored.z));
    float keep = kWater ? 1.0 : 1.0 - s.roughness;
    light += open * fresnel * mix(blurred, sharp, keep * keep) * (kWater ? 1.0 : mix(keep, 1.0, s.metallic));
  }
  if (kLamps) {
    for (uint i = 0u; i < frame.counts.y; ++i) {
      vec3 to = frame.lamps[i].position.xyz - p;
      float d2 = max(dot(to, to), 1e-4);
      vec3 l = to * inversesqrt(d2);
      vec4 e = frame.lamps[i].intensity / d2;
      float c = dot(n, l);
      light += diffuse / kPi * e * max(c, 0.0);
      if (kTranslucent) light += s.transmittance / kPi * e * max(-c, 0.0);
      if (kGlossy && c > 0.0) light += highlight(n, view, l, s.roughness, mix(vec4(0.04), s.reflectance, s.metallic)) * e * c;
    }
  }
  return kHaze ? through_air(light, p) : light;
}
