#version 460
layout(push_constant) uniform Push {
  vec4 row_x;  // to the cell's square, -1 to 1
  vec4 row_y;
  vec4 row_z;
  vec4 reflectance;     // red, green, blue; w: unused
  vec4 near_infrared;   // 850, 905, 1550 nm; w: transmittance over reflectance
};
layout(location = 0) in vec3 in_position;
layout(location = 1) in vec3 in_normal;
layout(location = 2) in vec2 in_uv;
layout(location = 0) out vec3 n;
layout(location = 1) out vec2 uv;

void main() {
  vec4 q = vec4(in_position, 1.0);
  n = in_normal;
  uv = in_uv;
  gl_Position = vec4(dot(row_x, q), dot(row_y, q), dot(row_z, q), 1.0);
}
