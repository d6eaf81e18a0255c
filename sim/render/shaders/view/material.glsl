// What rain and lying snow make of a surface.
#include "sim/render/shaders/shading.glsl.h"
layout(constant_id = 9) const bool kSnow = false;
layout(constant_id = 10) const bool kWet = false;

MaterialSample weathered(MaterialSample s, vec3 p, vec3 n) {
  if (kWet) s = wet(s, frame.weather.x, n.z);
  if (kSnow) s = snowy(s, frame.snow, s.takes_snow * snow_cover(p + frame.eye.xyz, n.z, frame.weather.y));
  return s;
}
