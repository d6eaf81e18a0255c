// The ideal linear-light picture of a small scene that a pinhole sees, row by row on the CPU: for each pixel
// the nearest body, the ground or the sky, and the light that it sends. Boxes, cylinders and their shadows
// are met exactly; patterns are averaged over the pixel. Internal to sim/render/scene.
#pragma once

#include <array>

#include "sim/render/scene/scene_frame.h"

namespace rigor::render {

/// Columns and rows of a picture.
struct PictureArea {
  int x0 = 0, y0 = 0, x1 = 0, y1 = 0;
};

/// Row `y` of the picture, columns area.x0 to area.x1, into `row`: for each channel the row's first element.
/// The same pixel has the same value whatever the area. Any thread.
void draw_scene_row(const SceneFrame& frame, int y, const PictureArea& area, int channels,
                    const std::array<float*, 3>& row);

}  // namespace rigor::render
