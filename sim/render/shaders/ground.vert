#version 460
#extension GL_GOOGLE_include_directive : require
#include "sim/render/shaders/bindings.glsl"
layout(location = 0) in vec3 position_camera;
layout(location = 1) in vec2 cell_position;
layout(location = 2) in ivec2 base_cell;
layout(location = 0) out vec3 p_camera;
layout(location = 1) out vec2 cells;
layout(location = 2) flat out ivec2 base;

void main() {
  p_camera = position_camera;
  cells = cell_position;
  base = base_cell;
  gl_Position = vec4(frame.projection.x * p_camera.x + frame.projection.y * p_camera.z,
                     frame.projection.z * p_camera.y + frame.projection.w * p_camera.z, frame.sun_camera.w, p_camera.z);
}
