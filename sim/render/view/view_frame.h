// The numbers that all shaders of a picture read. Internal to sim/render/view.
#pragma once

#include "sim/render/view/sky_light.h"
#include "sim/render/view/view_camera.h"

namespace rigor::render {

struct FrameNumbers {
  view_gpu::ViewFrame uniforms;
  bool sun = false;
  double sway_factor = 0;  ///< metres that a sway of 1 m at 10 m/s comes to
};

/// Where the camera is, and what moves or covers surfaces: all but light and air.
[[nodiscard]] FrameNumbers place_numbers(const ContentFrame& frame, const ViewRequest& request,
                                         const ViewCamera& camera);
/// All. `sky`: of the frame's sky map. `sky_scale`: what its texture must be multiplied by.
[[nodiscard]] FrameNumbers frame_numbers(const ContentFrame& frame, const ViewRequest& request,
                                         const ViewCamera& camera, const SkyLight& sky, float sky_scale);
/// What leaves or walls let through or throw about of the sky that they hide.
void set_covered(bool leaves, const view_gpu::Bands& bands, view_gpu::ViewFrame& uniforms);

}  // namespace rigor::render
