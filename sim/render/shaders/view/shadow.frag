#version 460
#extension GL_GOOGLE_include_directive : require
#define MAX_HAZES 1
#define MAX_LAMPS 1
#define MAX_CASCADES 1
#include "sim/render/shaders/view/view_structs.glsl.h"
layout(set = 1, binding = 0) uniform SurfaceBlock { SurfaceData surface; };
layout(set = 1, binding = 1) uniform sampler2D colour_map;
layout(location = 0) in vec2 uv;

void main() {
  if (texture(colour_map, uv).a < surface.gloss.z) discard;
}
