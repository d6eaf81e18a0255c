#version 460
// The camera's models are GLSL: compiled with the tests, drawn by nobody.
#extension GL_GOOGLE_include_directive : require
#include "sensor-hal/models/one_source.glsl.h"
#include "sensor-hal/models/angles.glsl.h"
#include "sensor-hal/models/opencv_lens.glsl.h"
#include "sensor-hal/models/fisheye_lens.glsl.h"
#include "sensor-hal/models/depth_of_field.glsl.h"
#include "sensor-hal/models/vignetting.glsl.h"
#include "sensor-hal/models/philox.glsl.h"
#include "sensor-hal/models/random_draws.glsl.h"
#include "sensor-hal/models/dark_current.glsl.h"
#include "sensor-hal/models/emva_noise.glsl.h"
#include "sensor-hal/models/bloom.glsl.h"
#include "sensor-hal/models/image_processing.glsl.h"
layout(local_size_x = 1) in;
layout(std430, set = 0, binding = 0) buffer B { float v[]; };
void main() {
  float x, y, z, valid, xd, yd;
  fisheye_unproject(v[0], v[1], v[2], v[3], v[4], v[5], v[6], 1e-6, x, y, z, valid);
  fisheye_project(x, y, z, v[2], v[3], v[4], v[5], v[6], xd, yd, valid);
  lens_undistort(xd, yd, v[2], v[3], v[4], v[5], v[6], 0.0, 0.0, 0.0, 1e-6, x, y, valid);
  v[7] = x + y + valid + vignetting_factor(x, y, v[0], v[1], v[2], v[3]);
  v[8] = blur_diameter_px(v[0], v[1], v[2], v[3], v[4]);
  v[9] = dark_current_at(v[0], v[1], v[2], v[3]) + hot_pixel_rate(v[0], v[1], v[2], v[3]);
  v[10] = bloom_kernel(v[0], v[1], v[2]) + bloom_mix(v[0], v[1], v[2], v[3], v[4]);
  v[11] = bloom_gaussian_height(v[0], v[1], v[2]) + bloom_gaussian_sigma(v[0], v[1]);
  v[12] = processed_dn(balanced_dn(v[0], v[1], v[2]), v[3], v[4], v[5], v[6]);
}
