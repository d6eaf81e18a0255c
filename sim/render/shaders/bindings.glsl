#include "sim/render/shaders/shared.glsl.h"
layout(std430, set = 0, binding = 0) readonly buffer FrameBlock { FrameUniforms frame; };
layout(std430, set = 0, binding = 1) readonly buffer BodyBlock { BodyData bodies[]; };
layout(std430, set = 0, binding = 2) readonly buffer CasterBlock { CasterData casters[]; };
layout(std430, set = 0, binding = 3) readonly buffer CasterListBlock { uint caster_list[]; };
layout(std430, set = 0, binding = 4) readonly buffer MaterialBlock { MaterialData materials[]; };
layout(std430, set = 0, binding = 5) readonly buffer TileBlock { TileData tiles[]; };
