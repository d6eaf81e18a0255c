#version 460
#extension GL_GOOGLE_include_directive : require
#define NORMALS
#include "sim/render/shaders/view/impostor_main.glsl"
