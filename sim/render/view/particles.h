// Rain and snow near the eye: each drop's place follows from its cell's numbers alone, so it is the same
// whatever was drawn before. Internal to sim/render/view.
#pragma once

#include <vector>

#include "rt-core/time.h"
#include "sim/render/view/view_camera.h"

namespace rigor::render {

/// A streak or a flake, as the shader takes it (two fields of 16 bytes).
struct Particle {
  view_gpu::vec4 head;  ///< relative to the eye; w: diameter [m]
  view_gpu::vec4 tail;  ///< where it was when the exposure began; w: how much of what lies behind it covers
};

/// Those in front of the camera, farthest first.
[[nodiscard]] std::vector<Particle> make_particles(const ViewCamera& camera,
                                                   const Precipitation& precipitation, BenchTime t);

}  // namespace rigor::render
