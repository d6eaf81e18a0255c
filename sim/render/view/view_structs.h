// The view shaders' structs (shaders/view/view_structs.glsl.h) in C++. Internal to sim/render/view.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <cstdint>
#include <type_traits>

#include "sim/render/content/texels.h"

namespace rigor::render::view_gpu {

struct alignas(16) vec4 {
  float x = 0, y = 0, z = 0, w = 0;
};
struct alignas(16) uvec4 {
  std::uint32_t x = 0, y = 0, z = 0, w = 0;
};

#define MAX_HAZES 4
#define MAX_LAMPS 128
#define MAX_CASCADES 5
#include "sim/render/shaders/view/view_structs.glsl.h"
constexpr std::size_t kMaxHazes = MAX_HAZES, kMaxLamps = MAX_LAMPS, kSunCascades = MAX_CASCADES - 1,
                      kZenith = MAX_CASCADES - 1;
#undef MAX_HAZES
#undef MAX_LAMPS
#undef MAX_CASCADES

static_assert(sizeof(ViewFrame) == 16 * 29 + 48 * 4 + 32 * 128 + 64 * 5);
static_assert(sizeof(SurfaceData) == 160 && sizeof(InstanceData) == 64);
static_assert(sizeof(DrawEntry) == 32 && sizeof(DrawnInstance) == 80);
static_assert(sizeof(RayData) == 32 && sizeof(HitData) == 48);
static_assert(std::is_trivially_copyable_v<ViewFrame>);

/// The bands of a picture, out of a spectrum.
using Bands = std::array<int, 4>;
[[nodiscard]] inline vec4 pick(const Spectrum& s, const Bands& b) {
  const auto at = [&](int i) { return s[static_cast<std::size_t>(b[static_cast<std::size_t>(i)])]; };
  return {at(0), at(1), at(2), at(3)};
}
[[nodiscard]] inline vec4 xyz(const Eigen::Vector3d& v, double w = 0) {
  return {static_cast<float>(v.x()), static_cast<float>(v.y()), static_cast<float>(v.z()),
          static_cast<float>(w)};
}
inline void put(const ColourToBand& m, vec4 (&out)[3]) {
  for (std::size_t i = 0; i < m.size(); ++i) out[i] = {m[i][0], m[i][1], m[i][2], m[i][3]};
}

}  // namespace rigor::render::view_gpu
