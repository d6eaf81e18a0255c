// What weather makes of surfaces, and surfaces and air of light: one source for the shaders of the view
// (sim/render/shaders/view) and for rays (sim/render/rays/shading.h, which gives C++ the words of GLSL that it
// lacks). Four bands at a time. Places are relative to the eye or another origin, with the world's axes, metres;
// radiance W/(m2 sr), irradiance W/m2; directions are of unit length.
#ifndef RIGOR_SHADING
#define RIGOR_SHADING
#ifndef __cplusplus
#define SHADING
#define all_bands(v) vec4(v)
const float kPi = 3.14159265358979;
// `otherwise` where a has no direction.
vec3 unit(vec3 a, vec3 otherwise) {
  float d2 = dot(a, a);
  return d2 > 1e-30 && d2 < 1e30 ? a * (1.0 / sqrt(d2)) : otherwise;
}
#endif

// A surface at a point: maps and tint are in it.
struct MaterialSample {
  vec4 reflectance, transmittance;
  float roughness, metallic, porosity, retro_reflection, takes_snow;
  bool translucent, glossy, water;
};

// Smooth noise that stands still in the world: cells of 1 m, period 1024 m. (Jarzynski and Olano 2020: PCG.)
SHADING uint pcg(uint v) {
  uint state = v * 747796405u + 2891336453u;
  uint word = ((state >> ((state >> 28u) + 4u)) ^ state) * 277803737u;
  return (word >> 22u) ^ word;
}
SHADING float noise_corner(int x, int y, int z) {
  uint cell = (uint(x) & 1023u) + 1024u * (uint(y) & 1023u) + 1048576u * (uint(z) & 1023u);
  return float(pcg(cell) >> 8u) / 16777216.0f;
}
SHADING float noise_eased(float f) { return f * f * (3.0f - 2.0f * f); }
SHADING float smooth_noise(vec3 p) {
  if (!(abs(p.x) < 1e9f && abs(p.y) < 1e9f && abs(p.z) < 1e9f)) return 0.5f;
  float bx = floor(p.x), by = floor(p.y), bz = floor(p.z);
  float fx = noise_eased(p.x - bx), fy = noise_eased(p.y - by), fz = noise_eased(p.z - bz);
  int x = int(bx), y = int(by), z = int(bz);
  return mix(mix(mix(noise_corner(x, y, z), noise_corner(x, y, z + 1), fz),
                 mix(noise_corner(x + 1, y, z), noise_corner(x + 1, y, z + 1), fz), fx),
             mix(mix(noise_corner(x, y + 1, z), noise_corner(x, y + 1, z + 1), fz),
                 mix(noise_corner(x + 1, y + 1, z), noise_corner(x + 1, y + 1, z + 1), fz), fx),
             fy);
}

// Of what a surface reflects, the share that it still does where it is wet; and how rough it is then.
SHADING float wet_share(float wetness, float porosity) { return 1.0f - 0.55f * wetness * porosity; }
SHADING float wet_roughness(float roughness, float wetness, float porosity, float up) {
  return mix(roughness, 0.15f, wetness * (0.35f + 0.65f * clamp(up, 0.0f, 1.0f)) * (1.0f - 0.5f * porosity));
}
// How much of a place lying snow covers. `place`: of the noise; `up`: the normal's z.
SHADING float snow_cover(vec3 place, float up, float depth_m) {
  float rough = 0.6f * smooth_noise(place * 4.0f) + 0.4f * smooth_noise(place * 16.0f);
  float deep = min(depth_m / 0.3f, 1.0f);
  // Deep snow holds on steeper slopes; a thin layer leaves gaps.
  float slope = up + 0.5f * (rough - 0.5f);
  float lies = smoothstep(0.55f - 0.35f * deep, 0.85f - 0.35f * deep, slope);
  return lies * clamp(depth_m / 0.02f - rough, 0.0f, 1.0f);
}
SHADING MaterialSample wet(MaterialSample s, float wetness, float up) {
  s.reflectance *= wet_share(wetness, s.porosity);
  s.roughness = wet_roughness(s.roughness, wetness, s.porosity, up);
  if (!s.water) s.glossy = true;
  return s;
}
SHADING MaterialSample snowy(MaterialSample s, vec4 snow, float covers) {
  s.reflectance = mix(s.reflectance, snow, covers);
  s.transmittance *= 1.0f - covers;
  s.roughness = mix(s.roughness, 1.0f, covers);
  s.metallic *= 1.0f - covers;
  s.retro_reflection *= 1.0f - covers;
  return s;
}

SHADING vec4 diffuse(MaterialSample s) { return s.glossy ? s.reflectance * (1.0f - s.metallic) : s.reflectance; }
SHADING vec4 mirrored_at_right_angles(MaterialSample s) {
  return s.water ? all_bands(0.02f) : mix(all_bands(0.04f), s.reflectance, s.metallic);
}

// GGX with Schlick's Fresnel term; the height-correlated visibility as 1 / (4 l.h^2) (Lazarov 2011).
SHADING vec4 highlight(vec3 n, vec3 view, vec3 light, float roughness, vec4 f0) {
  float alpha = max(roughness * roughness, 0.0025f);
  vec3 h = unit(view + light, n);
  float nh = max(dot(n, h), 0.0f), lh = max(dot(light, h), 0.05f);
  float f = nh * nh * (alpha * alpha - 1.0f) + 1.0f;
  float grazing = max(1.0f - lh, 0.0f), grazing2 = grazing * grazing;
  vec4 fresnel = f0 + (1.0f - f0) * (grazing2 * grazing2 * grazing);
  return fresnel * (alpha * alpha / (kPi * f * f) / (4.0f * lh * lh));
}

// False where no light of a direction can come to a point, whatever stands between: a face turned away from it is dark
// whatever its bumps say; a leaf may be lit through.
SHADING bool may_be_lit(MaterialSample s, vec3 n, vec3 n_flat, vec3 to_light) {
  float c = dot(n, to_light);
  return c * dot(n_flat, to_light) > 0.0f && (s.translucent || c > 0.0f);
}
// Light that leaves towards `view` where it falls from one direction, `irradiance` on a plane square to that.
SHADING vec4 lit_from(MaterialSample s, vec3 view, vec3 n, vec3 to_light, vec4 irradiance) {
  float c = dot(n, to_light);
  if (c <= 0.0f) return s.translucent ? s.transmittance * irradiance * (-c / kPi) : all_bands(0.0f);
  vec4 light = diffuse(s) / kPi;
  if (s.glossy || s.water) light += highlight(n, view, to_light, s.roughness, mirrored_at_right_angles(s));
  return light * irradiance * c;
}
// Of a lamp at a way `to` from the point.
SHADING vec4 lit_by_lamp(MaterialSample s, vec3 view, vec3 n, vec3 to, vec4 intensity) {
  // Half width of the cone in which a retro-reflector sends light back: of beaded sheeting, about half a degree.
  const float kRetroCone_rad = 0.0087f;
  float d2 = max(dot(to, to), 1e-4f);
  vec3 l = to * (1.0f / sqrt(d2));
  vec4 e = intensity / d2;
  vec4 light = lit_from(s, view, n, l, e);
  float c = dot(n, l);
  if (s.retro_reflection > 0.0f && c > 0.0f) {
    // A share of what falls on it, in a narrow cone about where it comes from. Less the cosine: what is sent back
    // leaves through as small an area as it came.
    vec3 apart = view - l;
    float width2 = kRetroCone_rad * kRetroCone_rad;
    light += e * (s.retro_reflection * c / (kPi * width2 * max(c, 0.05f)) * exp(-dot(apart, apart) / width2));
  }
  return light;
}
// What is diffusely scattered of the irradiances of both sides.
SHADING vec4 lit_all_round(MaterialSample s, vec4 irradiance, vec4 irradiance_behind) {
  vec4 light = diffuse(s) * irradiance;
  if (s.translucent) light += s.transmittance * irradiance_behind;
  return light / kPi;
}

// The mirror image of the surroundings: Fresnel's share of it, and how sharp it is: 0, the mean over the side of the
// mirrored direction, to 1, what lies in it. The sky's is the blurrier the rougher the surface; the mean over the lobe of
// a rough one is weak.
struct Mirror {
  vec3 direction;
  vec4 share;
  float sharp;
};
SHADING Mirror mirror(MaterialSample s, vec3 view, vec3 n) {
  float c = dot(n, view);
  vec4 f0 = mirrored_at_right_angles(s);
  float grazing = 1.0f - clamp(c, 0.0f, 1.0f), grazing2 = grazing * grazing;
  vec4 fresnel = f0 + (max(all_bands(1.0f - s.roughness), f0) - f0) * (grazing2 * grazing2 * grazing);
  float keep = s.water ? 1.0f : 1.0f - s.roughness;
  Mirror m;
  m.direction = n * (2.0f * c) - view;
  if (s.water) m.direction.z = abs(m.direction.z);
  m.share = fresnel * (s.water ? 1.0f : mix(keep, 1.0f, s.metallic));
  m.sharp = keep * keep;
  return m;
}
// How much of what lies in a mirrored direction is sky, the rest being ground.
SHADING float sky_in_mirror(vec3 direction) { return smoothstep(-0.1f, 0.05f, direction.z); }

// What share of the way between two heights lies below `top`.
SHADING float share_below(float top, float a_z, float b_z) {
  float low = min(a_z, b_z), high = max(a_z, b_z);
  return high - low > 1e-6f ? clamp((top - low) / (high - low), 0.0f, 1.0f) : (top > low ? 1.0f : 0.0f);
}
// Radiance behind air of this optical depth; `source`: of each of its layers, depth times the radiance that it gives.
SHADING vec4 behind_air(vec4 radiance, vec4 depth, vec4 source) {
  vec4 t = exp(-depth);
  return radiance * t + source / max(depth, all_bands(1e-30f)) * (1.0f - t);
}
// How much of the sun's disc a ray sees that is `width_rad` wide: its edge is as soft as that. Angle from the difference of
// unit vectors: the cosine has no precision near 1.
SHADING float disc_share(vec3 d, vec3 to_sun, float radius_rad, float width_rad) {
  float from_sun = 2.0f * asin(min(0.5f * length(d - to_sun), 1.0f));
  return clamp((radius_rad - from_sun) / width_rad + 0.5f, 0.0f, 1.0f);
}
#endif
