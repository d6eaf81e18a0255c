#version 460
#extension GL_GOOGLE_include_directive : require
#include "sim/render/shaders/view/sky_main.glsl"
