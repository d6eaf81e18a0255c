// The shaders' structs (shaders/shared.glsl.h) in C++. Internal to sim/render.
#pragma once

#include <cstddef>
#include <cstdint>
#include <type_traits>

namespace rigor::render::gpu {

struct alignas(16) vec4 {
  float x = 0, y = 0, z = 0, w = 0;
};
struct alignas(16) uvec4 {
  std::uint32_t x = 0, y = 0, z = 0, w = 0;
};

#define INLINE_CASTERS 16
#include "sim/render/shaders/shared.glsl.h"
#undef INLINE_CASTERS
constexpr std::size_t kInlineCasters = std::extent_v<decltype(SurfaceData::casters)>;

static_assert(sizeof(FrameUniforms) == 112 && sizeof(MaterialData) == 48 && sizeof(CasterData) == 64);
static_assert(sizeof(SurfaceData) == 1216 && offsetof(SurfaceData, casters) == 176);
static_assert(sizeof(SensorUniforms) == 128 && sizeof(LensUniforms) == 96);
static_assert(std::is_trivially_copyable_v<FrameUniforms> && std::is_trivially_copyable_v<SensorUniforms>);

/// Vertices of the shaders body.vert and ground.vert.
struct BodyVertex {
  float position[3];
  float normal[3];
};
struct GroundVertex {
  float position_camera[3];
  float cell_position[2];
  std::int32_t base_cell[2];
};
static_assert(sizeof(BodyVertex) == 24 && sizeof(GroundVertex) == 28);

}  // namespace rigor::render::gpu
