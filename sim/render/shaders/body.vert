#version 460
#extension GL_GOOGLE_include_directive : require
#include "sim/render/shaders/bindings.glsl"
layout(location = 0) in vec3 unit_position;
layout(location = 1) in vec3 unit_normal;
layout(location = 0) out vec3 p_camera;
layout(location = 1) out vec3 n_camera;
layout(location = 2) out vec3 p_body;
layout(location = 3) out vec3 n_body;

void main() {
  p_body = unit_position * surface.half_size.xyz;
  n_body = unit_normal;
  vec4 q = vec4(p_body, 1.0);
  p_camera = vec3(dot(surface.row0, q), dot(surface.row1, q), dot(surface.row2, q));
  n_camera = vec3(dot(surface.row0.xyz, n_body), dot(surface.row1.xyz, n_body), dot(surface.row2.xyz, n_body));
  gl_Position = vec4(frame.projection.x * p_camera.x + frame.projection.y * p_camera.z,
                     frame.projection.z * p_camera.y + frame.projection.w * p_camera.z, frame.sun_camera.w, p_camera.z);
}
