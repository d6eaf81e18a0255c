// Four bands at once, and places in float. Internal to sim/render/rays.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numbers>

namespace rigor::render::light {

inline constexpr float kPi = std::numbers::pi_v<float>;

/// A value in each of four bands: one register.
using Bands4 = float __attribute__((vector_size(16)));

[[nodiscard]] constexpr Bands4 all_bands(float v) noexcept { return Bands4{v, v, v, v}; }
[[nodiscard]] inline Bands4 max(Bands4 a, Bands4 b) noexcept { return a > b ? a : b; }
[[nodiscard]] inline Bands4 min(Bands4 a, Bands4 b) noexcept { return a < b ? a : b; }
[[nodiscard]] inline Bands4 mix(Bands4 a, Bands4 b, float t) noexcept { return a + (b - a) * t; }
[[nodiscard]] inline Bands4 mix(Bands4 a, Bands4 b, Bands4 t) noexcept { return a + (b - a) * t; }
[[nodiscard]] inline float mix(float a, float b, float t) noexcept { return a + (b - a) * t; }
[[nodiscard]] inline float mean(Bands4 a) noexcept { return 0.25F * ((a[0] + a[1]) + (a[2] + a[3])); }
[[nodiscard]] inline float largest(Bands4 a) noexcept {
  return std::max(std::max(a[0], a[1]), std::max(a[2], a[3]));
}
/// Of what is not above 0, or not a number: 0.
[[nodiscard]] inline Bands4 not_negative(Bands4 a) noexcept { return a > 0.0F ? a : Bands4{}; }

struct Vec3 {
  float x = 0, y = 0, z = 0;
  bool operator==(const Vec3&) const = default;
};
[[nodiscard]] constexpr Vec3 operator+(Vec3 a, Vec3 b) noexcept { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
[[nodiscard]] constexpr Vec3 operator-(Vec3 a, Vec3 b) noexcept { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
[[nodiscard]] constexpr Vec3 operator-(Vec3 a) noexcept { return {-a.x, -a.y, -a.z}; }
[[nodiscard]] constexpr Vec3 operator*(Vec3 a, float k) noexcept { return {a.x * k, a.y * k, a.z * k}; }
[[nodiscard]] constexpr float dot(Vec3 a, Vec3 b) noexcept { return a.x * b.x + a.y * b.y + a.z * b.z; }
[[nodiscard]] constexpr Vec3 cross(Vec3 a, Vec3 b) noexcept {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
[[nodiscard]] inline float length(Vec3 a) noexcept { return std::sqrt(dot(a, a)); }
[[nodiscard]] inline bool finite(Vec3 a) noexcept { return std::isfinite(a.x + a.y + a.z); }
[[nodiscard]] inline Vec3 from(const float v[3]) noexcept { return {v[0], v[1], v[2]}; }
/// `otherwise` where a has no direction.
[[nodiscard]] inline Vec3 unit(Vec3 a, Vec3 otherwise) noexcept {
  const float d2 = dot(a, a);
  return d2 > 1e-30F && d2 < 1e30F ? a * (1.0F / std::sqrt(d2)) : otherwise;
}
[[nodiscard]] inline float smoothstep(float low, float high, float v) noexcept {
  const float t = std::clamp((v - low) / (high - low), 0.0F, 1.0F);
  return t * t * (3.0F - 2.0F * t);
}
/// Of 32 random bits, above 0 and below 1 (or 1 itself, rounded).
[[nodiscard]] inline float unit_draw(std::uint32_t word) noexcept {
  return (static_cast<float>(word >> 8U) + 0.5F) * (1.0F / 16777216.0F);
}
/// Two directions that are square to a unit vector and to each other (Duff et al. 2017).
inline void frame_about(Vec3 n, Vec3& a, Vec3& b) noexcept {
  const float s = std::copysign(1.0F, n.z);
  const float k = -1.0F / (s + n.z), m = n.x * n.y * k;
  a = {1.0F + s * n.x * n.x * k, s * m, -s * n.x};
  b = {m, s + n.y * n.y * k, -n.y};
}

}  // namespace rigor::render::light
