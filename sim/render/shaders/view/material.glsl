// What a surface is at a point, and what rain and lying snow make of it.
layout(constant_id = 9) const bool kSnow = false;
layout(constant_id = 10) const bool kWet = false;

struct MaterialSample {
  vec4 reflectance;
  vec4 transmittance;
  float roughness;
  float metallic;
  float porosity;
  float takes_snow;
};

MaterialSample weathered(MaterialSample s, vec3 p, vec3 n) {
  if (kWet) {
    float wet = frame.weather.x;
    s.reflectance *= 1.0 - 0.55 * wet * s.porosity;
    s.roughness = mix(s.roughness, 0.15, wet * (0.35 + 0.65 * clamp(n.z, 0.0, 1.0)) * (1.0 - 0.5 * s.porosity));
  }
  if (kSnow) {
    vec3 at = p + frame.eye.xyz;
    float rough = 0.6 * smooth_noise(at * 4.0) + 0.4 * smooth_noise(at * 16.0);
    float depth = frame.weather.y;
    // Deep snow holds on steeper slopes; a thin layer leaves gaps.
    float slope = n.z + 0.5 * (rough - 0.5);
    float lies = smoothstep(0.55 - 0.35 * min(depth / 0.3, 1.0), 0.85 - 0.35 * min(depth / 0.3, 1.0), slope);
    float covers = clamp(depth / 0.02 - rough, 0.0, 1.0);
    float snow = s.takes_snow * lies * covers;
    s.reflectance = mix(s.reflectance, frame.snow, snow);
    s.transmittance *= 1.0 - snow;
    s.roughness = mix(s.roughness, 1.0, snow);
    s.metallic *= 1.0 - snow;
  }
  return s;
}
