#version 460
#extension GL_GOOGLE_include_directive : require
// Depth alone, of what has holes: shading then happens where a surface is seen, and nowhere else.
#define MAX_HAZES 1
#define MAX_LAMPS 1
#define MAX_CASCADES 1
#include "sim/render/shaders/view/view_structs.glsl.h"
#include "sim/render/shaders/shading.glsl.h"
#include "sim/render/shaders/view/holes.glsl"
layout(set = 1, binding = 0) uniform SurfaceBlock { SurfaceData surface; };
layout(set = 1, binding = 1) uniform sampler2D colour_map;
layout(location = 2) in vec2 uv;
layout(location = 5) flat in uint seed;

void main() { cut_holes(texture(colour_map, uv).a, surface.gloss.z, seed); }
