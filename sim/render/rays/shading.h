// The arithmetic of shading that rays share with the shaders of the view, in C++. Internal to
// sim/render/rays.
#pragma once

#include <cstdint>
#include <cstring>

#include "sim/render/rays/light_vec.h"

namespace rigor::render::light {

// The words of GLSL.
using vec3 = Vec3;
using vec4 = Bands4;
using uint = std::uint32_t;
using std::abs;
using std::asin;
using std::exp;
using std::floor;
using std::sqrt;
[[nodiscard]] constexpr float min(float a, float b) noexcept { return b < a ? b : a; }
[[nodiscard]] constexpr float max(float a, float b) noexcept { return a < b ? b : a; }
[[nodiscard]] constexpr float clamp(float v, float low, float high) noexcept {
  return v < low ? low : high < v ? high : v;
}

/// e^v for v ≤ 0 within 3e-7 of it; 0 below -87.
[[nodiscard]] inline Bands4 exp(Bands4 v) noexcept {
  using Words = std::int32_t __attribute__((vector_size(16)));
  const Bands4 t = max(v, all_bands(-87.0F)) * std::numbers::log2e_v<float>;
  const Words whole = __builtin_convertvector(t - 0.5F, Words);  // towards 0: t is not positive
  const Bands4 f = (t - __builtin_convertvector(whole, Bands4)) * std::numbers::ln2_v<float>;
  Bands4 p = all_bands(1.0F / 720);
  p = p * f + 1.0F / 120;
  p = p * f + 1.0F / 24;
  p = p * f + 1.0F / 6;
  p = p * f + 0.5F;
  p = p * f + 1.0F;
  p = p * f + 1.0F;
  const Words scale = (whole + 127) << 23;
  Bands4 s;
  std::memcpy(&s, &scale, sizeof s);
  return v > -87.0F ? p * s : Bands4{};
}

#define SHADING [[nodiscard]] inline
#include "sim/render/shaders/shading.glsl.h"
#undef SHADING

}  // namespace rigor::render::light
