#define INLINE_CASTERS 16
#include "sim/render/shaders/shared.glsl.h"
layout(std140, set = 0, binding = 0) uniform FrameBlock { FrameUniforms frame; };
layout(std140, set = 0, binding = 1) uniform SurfaceBlock { SurfaceData surface; };
layout(std430, set = 0, binding = 2) readonly buffer CasterBlock { CasterData all_casters[]; };
layout(std430, set = 0, binding = 3) readonly buffer CasterListBlock { uint caster_list[]; };
