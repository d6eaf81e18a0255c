// The light that the rays of a row bring from a small scene: for each the nearest body, the ground or the
// sky. Boxes, cylinders and their shadows are met exactly; patterns are averaged over a ray's width. Internal
// to sim/render/scene.
#pragma once

#include <array>
#include <cstdint>

#include "sim/render/scene/lens_rays.h"
#include "sim/render/scene/scene_frame.h"

namespace rigor::render {

/// For each ray the light, in `channels` rows of electrons per second, and in `met` a number that differs
/// where neighbours meet other faces or one of them is in a shadow. Rays beside each other mostly meet the
/// same. What a ray brings does not depend on those beside it. Any thread.
void draw_row(const SceneFrame& frame, const RayRow& rays, int channels, const std::array<float*, 3>& light,
              std::int32_t* met);
/// The light of rays in any order.
void draw_rays(const SceneFrame& frame, const RayRow& rays, int channels, const std::array<float*, 3>& light);

}  // namespace rigor::render
