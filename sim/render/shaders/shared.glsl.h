// Structs that the host fills and the shaders read, from one place. Only vec4 and uvec4 members, so that
// in std140 and std430 offsets are multiples of 16 on both sides; sim/render/gpu_structs.h includes it for C++ and asserts the sizes.

// Electrons per second and channel that a matt surface of the material sends to a pixel on the axis:
// sun cos(theta) visible + ambient_0 + ambient_1 (n . up).
struct MaterialData {
  vec4 sun;        // w: roughness
  vec4 ambient_0;
  vec4 ambient_1;
};

// One per picture. Camera frame: optical frame of the sensor (x right, y down, z forward), metres.
struct FrameUniforms {
  vec4 projection;      // clip = (x0 x + x1 z, x2 y + x3 z, near, z)
  vec4 sun_camera;      // direction to the sun; w: near plane [m]
  vec4 up_camera;       // world up; w: unused
  vec4 sky_horizon;     // electrons per second and channel looking at the horizon
  vec4 sky_gradient;    // zenith minus horizon
  vec4 below_horizon;   // looking below the horizon past the end of the ground
  vec4 sun_specular;    // electrons per second and channel of the sun's irradiance, for highlights
};

// Something that may stand between a surface and the sun: p_unit = rows (p_camera, 1); a box is [-1, 1]^3, a cylinder
// x^2 + y^2 <= 1, |z| <= 1.
struct CasterData {
  vec4 row0;
  vec4 row1;
  vec4 row2;
  vec4 sun_unit;  // direction to the sun in unit coordinates; w: 1 for a cylinder
};

// One per draw: a body, or the tiles of the ground that the same bodies may shade. Held in a uniform block and indexed
// by constants alone, because software drivers broadcast such loads and gather all others lane by lane.
struct SurfaceData {
  vec4 row0;        // bodies: p_camera = (row0, row1, row2) (half_size * p_unit, 1)
  vec4 row1;
  vec4 row2;
  vec4 half_size;   // w: unused
  vec4 pattern;     // board: squares along x, along y, 1 / square [1/m]; ground: noise contrast, noise cells per cell
  MaterialData material;
  MaterialData other;  // of the board's dark squares; of the ground's odd cells
  CasterData casters[INLINE_CASTERS];  // those beyond the list's end stand where they shade nothing
  uvec4 caster_range;  // in the long list, for the variant that loops: first, number, unused, unused
};

// One per capture.
struct SensorUniforms {
  uvec4 region;     // offset x, offset y, width, height [px]
  uvec4 sensor;     // full width, full height, key word 0, key word 1
  uvec4 capture;    // capture index low, high, output shift (adc bits - picture bits), words of the output
  vec4 exposure;    // exposure [s], K times gain [DN/e-], black [DN], largest DN
  vec4 noise;       // read noise [e-], full well [e-], dark rate [e-/s], response c2
  vec4 picture;     // focal_x, focal_y [picture px], centre_u, centre_v [picture px, centres at integers]
  vec4 tap;         // distance of the taps [picture px], number along one side, 1 / number of taps, response c3
  vec4 picture_limit;  // largest position from which two by two pixels can be read: x, y, unused, unused
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
