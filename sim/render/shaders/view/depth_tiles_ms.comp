#version 460
#extension GL_GOOGLE_include_directive : require
#define MULTISAMPLED
#include "sim/render/shaders/view/depth_tiles_main.glsl"
