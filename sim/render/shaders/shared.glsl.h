// Structs that the host fills and the shaders read, from one place. std430: only vec4 and uvec4 members, so that
// offsets are multiples of 16 on both sides; sim/render/gpu_structs.h includes it for C++ and asserts the sizes.

// One per picture. Camera frame: optical frame of the sensor (x right, y down, z forward), metres.
struct FrameUniforms {
  vec4 projection;      // clip = (x0 x + x1 z, x2 y + x3 z, near, z)
  vec4 picture;         // focal_x, focal_y [picture px], centre_u, centre_v [picture px, centres at integers]
  vec4 sun_camera;      // direction to the sun; w: near plane [m]
  vec4 up_camera;       // world up; w: unused
  vec4 sky_horizon;     // electrons per second and channel looking at the horizon
  vec4 sky_gradient;    // zenith minus horizon
  vec4 below_horizon;   // looking below the horizon past the end of the ground
  vec4 sun_specular;    // electrons per second and channel of the sun's irradiance, for highlights
  vec4 ground;          // noise contrast, cell [m], noise cells per cell, unused
  uvec4 ground_material;  // material, other material, unused, unused
};

// Electrons per second and channel that a matt surface of the material sends to a pixel on the axis:
// sun cos(theta) visible + ambient_0 + ambient_1 (n . up).
struct MaterialData {
  vec4 sun;        // w: roughness
  vec4 ambient_0;
  vec4 ambient_1;
};

struct BodyData {
  vec4 row0;  // p_camera = (row0, row1, row2) (half_size * p_unit, 1)
  vec4 row1;
  vec4 row2;
  vec4 half_size;   // w: unused
  uvec4 surface;    // material, dark material of the board, first caster, number of casters
  vec4 board;       // squares along x, along y (0: no board), 1 / square [1/m], unused
};

// Something that may stand between a surface and the sun: p_unit = rows (p_camera, 1); a box is [-1, 1]^3, a cylinder
// x^2 + y^2 <= 1, |z| <= 1.
struct CasterData {
  vec4 row0;
  vec4 row1;
  vec4 row2;
  vec4 sun_unit;  // direction to the sun in unit coordinates; w: 1 for a cylinder
};

struct TileData {
  uvec4 base_and_casters;  // even base cell x, y (two's complement), first caster, number of casters
};

// One per capture.
struct SensorUniforms {
  uvec4 region;     // offset x, offset y, width, height [px]
  uvec4 sensor;     // full width, full height, key word 0, key word 1
  uvec4 capture;    // capture index low, high, output shift (adc bits - picture bits), words of the output
  vec4 exposure;    // exposure [s], K times gain [DN/e-], black [DN], largest DN
  vec4 noise;       // read noise [e-], full well [e-], dark rate [e-/s], unused
  vec4 picture;     // as in FrameUniforms
  vec4 tap;         // distance of the taps [picture px], number along one side, 1 / number of taps, unused
  uvec4 picture_size;  // width, height, unused, unused
};

// One per set-up of the lens map.
struct LensUniforms {
  vec4 camera;      // fx, fy, cx, cy [px]
  vec4 lens_a;      // k1, k2, p1, p2
  vec4 lens_b;      // k3, k4, k5, k6
  vec4 vignetting;  // cos4 weight, a2, a4, a6
  vec4 pattern;     // PRNU, DSNU [e-], 1: draw them, unused
  uvec4 sensor;     // width, height, key word 0, key word 1
};
