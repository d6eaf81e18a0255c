#version 460
#extension GL_GOOGLE_include_directive : require
#define ALPHA
#include "sim/render/shaders/view/range_main.glsl"
