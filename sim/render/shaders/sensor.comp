#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_samplerless_texture_functions : require
// From the ideal linear picture to the bytes of the camera: lens, exposure, noise, quantisation, packing.
#include "sensor-hal/models/one_source.glsl.h"
#include "sensor-hal/models/philox.glsl.h"
#include "sensor-hal/models/random_draws.glsl.h"
#include "sensor-hal/models/emva_noise.glsl.h"
#define INLINE_CASTERS 16
#include "sim/render/shaders/shared.glsl.h"
layout(local_size_x = 64) in;
layout(constant_id = 0) const int kFormat = 0;  // mono8, mono12p, mono in words, bayer_rg8, rgb8, bayer_rg in words
layout(constant_id = 1) const bool kShotNoise = true;
layout(constant_id = 2) const bool kReadNoise = true;
layout(constant_id = 3) const int kTaps = 1;  // along one side
layout(std140, set = 0, binding = 8) uniform SensorBlock { SensorUniforms u; };
layout(std430, set = 0, binding = 9) writeonly buffer OutputBlock { uint words_out[]; };
layout(set = 0, binding = 10) uniform texture2D picture;
layout(set = 0, binding = 11) uniform texture2D lens_map;  // x, y of the ideal ray, gain, offset [e-]

const int kMono12p = 1;
const int kMono16 = 2;
const int kBayer = 3;
const int kRgb = 4;
const int kBayer16 = 5;

vec3 fetch(ivec2 p) { return texelFetch(picture, p, 0).rgb; }

vec3 bilinear(vec2 position) {
  position = clamp(position, vec2(0.0), u.picture_limit.xy);
  vec2 corner = floor(position);
  vec2 f = position - corner;
  ivec2 p = ivec2(corner);
  return mix(mix(fetch(p), fetch(p + ivec2(1, 0)), f.x), mix(fetch(p + ivec2(0, 1)), fetch(p + ivec2(1, 1)), f.x), f.y);
}

// Mean over the pixel's footprint.
vec3 ideal_rate(vec2 ray) {
  vec2 centre = ray * u.picture.xy + u.picture.zw;
  if (kTaps == 1) return bilinear(centre);
  vec3 sum = vec3(0.0);
  float first = -0.5 * float(kTaps - 1);
  for (int j = 0; j < kTaps; ++j)
    for (int i = 0; i < kTaps; ++i) sum += bilinear(centre + (vec2(float(i), float(j)) + first) * u.tap.x);
  return sum * u.tap.z;
}

uint digital_number(float rate, vec4 pixel, uint shot_bits, uint read_bits) {
  float e = emva_mean_electrons(rate, u.noise.z, pixel.z, u.exposure.x);
  if (kShotNoise) e = poisson_quantile(e, unit_from_bits(shot_bits));
  float z = 0.0;
  if (kReadNoise) z = normal_quantile(unit_from_bits(read_bits));
  e = emva_collected_electrons(e, u.noise.y, pixel.w, u.noise.x, z);
  float y = emva_analogue_dn(e, u.exposure.y, u.exposure.z);
  if (u.noise.w != 0.0 || u.tap.w != 0.0)
    y = u.exposure.z + emva_response(emva_analogue_dn(e, u.exposure.y, 0.0), u.exposure.w - u.exposure.z, u.noise.w, u.tap.w);
  return uint(emva_quantise(y, u.exposure.w)) >> u.capture.z;
}

void main() {
  const int pixels = kFormat == kMono12p ? 8 : 4;
  const int bits = kFormat == kMono12p ? 12 : kFormat == kMono16 || kFormat == kBayer16 ? 16 : kFormat == kRgb ? 24 : 8;
  const int words = pixels * bits / 32;
  uint invocation = gl_GlobalInvocationID.y * (gl_NumWorkGroups.x * gl_WorkGroupSize.x) + gl_GlobalInvocationID.x;
  uint first = invocation * uint(pixels);
  uint total = u.region.z * u.region.w;
  if (first >= total) return;
  uint packed[3] = uint[3](0u, 0u, 0u);
  // One division for all pixels of the invocation: it is the dearest instruction here.
  uint region_row = first / u.region.z;
  uint region_column = first - region_row * u.region.z;
  for (int i = 0; i < pixels; ++i) {
    // Past the region's end some spare pixels are worked out over again; nobody reads them.
    uint column = u.region.x + region_column;
    uint row = min(u.region.y + region_row, u.sensor.y - 1u);
    region_column += 1u;
    if (region_column == u.region.z) {
      region_column = 0u;
      region_row += 1u;
    }
    uint element = row * u.sensor.x + column;
    vec4 pixel = texelFetch(lens_map, ivec2(column, row), 0);
    vec3 rate = ideal_rate(pixel.xy);
    uint w0 = 0u;
    uint w1 = 0u;
    uint w2 = 0u;
    uint w3 = 0u;
    if (kShotNoise || kReadNoise)
      philox4x32_10(element, 1u, u.capture.x, u.capture.y, u.sensor.z, u.sensor.w, w0, w1, w2, w3);
    if (kFormat == kRgb) {
      uint red = digital_number(rate.x, pixel, w0, w1);
      uint green = digital_number(rate.y, pixel, w2, w3);
      if (kShotNoise || kReadNoise)
        philox4x32_10(element, 2u, u.capture.x, u.capture.y, u.sensor.z, u.sensor.w, w0, w1, w2, w3);
      uint blue = digital_number(rate.z, pixel, w0, w1);
      uint value = red | green << 8 | blue << 16;
      int bit = 24 * i;
      packed[bit >> 5] |= value << (bit & 31);
      if ((bit & 31) > 8) packed[(bit >> 5) + 1] |= value >> (32 - (bit & 31));
    } else {
      float r = rate.x;
      if (kFormat == kBayer || kFormat == kBayer16) {
        uint site = (row & 1u) * 2u + (column & 1u);
        r = site == 0u ? rate.x : site == 3u ? rate.z : rate.y;
      }
      uint value = digital_number(r, pixel, w0, w1);
      int bit = bits * i;
      packed[bit >> 5] |= value << (bit & 31);
      if ((bit & 31) + bits > 32) packed[(bit >> 5) + 1] |= value >> (32 - (bit & 31));
    }
  }
  uint at = invocation * uint(words);
  for (int i = 0; i < words; ++i)
    if (at + uint(i) < u.capture.w) words_out[at + uint(i)] = packed[i];
}
