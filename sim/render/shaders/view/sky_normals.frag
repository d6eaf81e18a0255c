#version 460
#extension GL_GOOGLE_include_directive : require
#define NORMALS
#include "sim/render/shaders/view/sky_main.glsl"
