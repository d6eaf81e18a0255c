// Structs that the view renderer fills and its shaders read, from one place. Only vec4 and uvec4 members, so that
// std140 and std430 agree with C++; sim/render/view/view_structs.h includes it for C++ and asserts the sizes.
//
// Places are relative to the eye with the world's axes (x east, y north, z up), metres. A vec4 of light holds the four
// bands that the picture has. Radiance W/(m2 sr), irradiance W/m2.

struct HazeData {
  vec4 extinction;  // per metre
  vec4 inscatter;
  vec4 top;         // x: its height above the eye
};

struct LampData {
  vec4 position;
  vec4 intensity;   // W/sr
};

// A shadow map: texture coordinates and depth = (row_x, row_y, row_z) (p, 1), in texels and 0 (towards the sun) to 1.
struct CascadeData {
  vec4 row_x;
  vec4 row_y;
  vec4 row_z;
  vec4 range;       // x: view depth up to which it serves (of the zenith's: |x| and |y|), y: size of a texel [m], z: texels along a side, w: depth [m]
};

// One per picture.
struct ViewFrame {
  vec4 clip_x;      // clip = (clip_x.p, clip_y.p, near, clip_w.p); w: near plane [m]
  vec4 clip_y;
  vec4 clip_w;      // w: angle of a pixel [rad]
  vec4 ray_0;       // direction of a ray = ray_0 + ray_x ndc.x + ray_y ndc.y
  vec4 ray_x;
  vec4 ray_y;
  vec4 sun;         // direction to it; w: angular radius [rad]
  vec4 sun_irradiance;
  vec4 sun_disc;    // its radiance
  vec4 sky_light[9];  // irradiance by normal: polynomials of order 2
  vec4 ground;      // radiance of what lies below the horizon
  vec4 tint_to_band[3];  // how red, green and blue of a tint multiply the bands
  vec4 snow;        // reflectance of lying snow
  vec4 weather;     // wetness, snow depth [m], sky texture's factor, unused
  vec4 eye;         // its place modulo 1024 m, for noise that stands still; w: unused
  vec4 wind;        // sway of 1 m at 10 m/s becomes this many metres; w: unused
  vec4 gust;        // phases of slow and fast sway [rad], unused
  vec4 covered;     // what comes through and off leaves and walls, as a share of the sky they hide
  uvec4 counts;     // hazes, lamps, cascades, unused
  HazeData hazes[MAX_HAZES];
  LampData lamps[MAX_LAMPS];
  CascadeData cascades[MAX_CASCADES];  // of the sun; the last one looks down from the zenith
};

// One per surface.
struct SurfaceData {
  vec4 reflectance;
  vec4 transmittance;
  vec4 colour_to_band[3];
  vec4 near_infrared_to_band[3];
  vec4 gloss;       // roughness, metallic, alpha cutoff, porosity
  vec4 flags;       // takes snow, retro-reflection, unused
};

// An instance as it lies in its batch.
struct InstanceData {
  vec4 position;    // relative to the batch; w: phase [rad]
  vec4 rotation;
  vec4 scale;       // w: sway of its prototype [m]
  vec4 tint;
};

// An instance that is drawn: where its batch lies.
struct DrawEntry {
  vec4 origin;      // of the batch
  uvec4 slot;       // instance, place in the list, identity, seed
};

// What the vertex shaders read, one per drawn instance.
struct DrawnInstance {
  vec4 row0;        // p = (row0, row1, row2) (p_prototype, 1), relative to the eye, of casters to their map's middle
  vec4 row1;
  vec4 row2;
  vec4 tint;        // w: phase [rad]
  uvec4 extra;      // identity, bits of the sway [m], seed, unused
};

// A ray of a range view.
struct RayData {
  vec4 direction;   // unit length; w: farthest range [m]
  vec4 at;          // where it goes through the view [px], unused
};

// What it meets.
struct HitData {
  vec4 normal;      // towards the eye; w: range [m]
  uvec4 what;       // identity (0: nothing), surface, halves: transmittance, metallic, unused
  vec4 rest;        // reflectance, roughness, texture coordinate
};
