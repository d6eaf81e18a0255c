// The error models in C++, over any number type: the same files that the shaders include.
//
//   using Lens = models::LensMath<double>;                 // or float, or ceres::Jet<double, N>
//   double xd, yd;
//   Lens::lens_distort(x, y, k1, k2, p1, p2, k3, k4, k5, k6, xd, yd);
//
// A calibrator includes Ceres first: argument-dependent look-up then finds Ceres' sqrt, log, exp and floor.
// All functions: any thread, no allocation, no state.
#pragma once

#include <cmath>
#include <cstdint>

namespace rigor::models {

using std::exp;
using std::exp2;
using std::floor;
using std::log;
using std::sqrt;

namespace detail {
/// 32 x 32 -> 64 bit product, as GLSL's umulExtended gives it.
constexpr void multiply_extended(std::uint32_t a, std::uint32_t b, std::uint32_t& high, std::uint32_t& low) {
  const std::uint64_t product = static_cast<std::uint64_t>(a) * b;
  high = static_cast<std::uint32_t>(product >> 32);
  low = static_cast<std::uint32_t>(product);
}
}  // namespace detail

#define FN static inline
#define OUT(type) type&
#define UINT std::uint32_t
#define PHILOX_MUL(a, b, hi, lo) detail::multiply_extended(a, b, hi, lo)

/// OpenCV's lens model, the fisheye, vignetting and depth of field: see the files' own heads.
template <class REAL>
struct LensMath {
#include "sensor-hal/models/angles.glsl.h"
#include "sensor-hal/models/opencv_lens.glsl.h"
//
#include "sensor-hal/models/depth_of_field.glsl.h"
#include "sensor-hal/models/fisheye_lens.glsl.h"
#include "sensor-hal/models/vignetting.glsl.h"
};

/// Spread light and the camera's own processing: see bloom.glsl.h, image_processing.glsl.h.
template <class REAL>
struct PictureMath {
#include "sensor-hal/models/bloom.glsl.h"
#include "sensor-hal/models/image_processing.glsl.h"
};

/// Draws, dark current and the EMVA 1288 pixel: see random_draws.glsl.h, dark_current.glsl.h,
/// emva_noise.glsl.h.
template <class REAL>
struct NoiseMath {
#include "sensor-hal/models/random_draws.glsl.h"
//
#include "sensor-hal/models/dark_current.glsl.h"
#include "sensor-hal/models/emva_noise.glsl.h"
};

/// Philox 4x32-10 as plain integers: see philox.glsl.h, philox.h for the keys.
struct PhiloxMath {
#include "sensor-hal/models/philox.glsl.h"
};

#undef FN
#undef OUT
#undef UINT
#undef PHILOX_MUL

}  // namespace rigor::models
