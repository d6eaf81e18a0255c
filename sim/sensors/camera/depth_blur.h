// Depth of field of a picture that is sharp everywhere: every pixel gathers what the discs of its neighbours
// put on it, the nearer ones over the further ones. Internal to sim/sensors/camera.
#pragma once

#include <vector>

namespace rigor {

struct BlurPicture {
  int width_px = 0, height_px = 0;
  std::vector<float> radiance;  ///< 4 a pixel
  /// Radius of a pixel's disc, px: negative in front of what is in focus, so that it grows with depth; NaN:
  /// no light reaches this pixel.
  std::vector<float> radius_px;
};

/// Discs are no larger than this.
inline constexpr int kMaxBlurRadius_px = 24;

/// Channels [first_band, last_band) of the pixels that lie at least `border_px` inside, row by row, into
/// `out` (4 a pixel, without the border). What is hidden behind something out of focus is unknown, and taken
/// to look as what is seen beside it. Depends on nothing further than `border_px` away.
void blur_by_depth(const BlurPicture& in, int border_px, int first_band, int last_band, float* out);

}  // namespace rigor
