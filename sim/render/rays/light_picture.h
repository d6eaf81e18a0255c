// Pictures by rays: what ViewRenderer draws, from a LightTracer.
#pragma once

#include <functional>

#include "sim/render/rays/light_tracer.h"
#include "sim/render/view/view_renderer.h"

namespace rigor::render {

struct LightPictureRequest {
  Eigen::Isometry3d T_world_camera = Eigen::Isometry3d::Identity();  ///< of the optical frame
  Pinhole pinhole{};
  std::array<int, 4> bands{0, 1, 2, 3};
  /// Samples along each side of a pixel, in the middles of as many squares: 1 is the pixel's centre.
  int samples_a_side = 1;
  bool shadows = true;
  int sky_rays = 0, bounces = 1;
  /// Without sky rays, and with shadows: light of the surroundings is gathered. Off: the open sky.
  bool gather = true;
  bool soft_sun = false;
  std::uint64_t seed = 0;
  float time = 0;  ///< of the window: 0 its begin … 1 its end
  /// Told the share of the picture that is done, now and then. Same thread.
  std::function<void(double)> progress = {};
};

/// Radiance is the mean of a pixel's samples; depth and node are those of the sample nearest to its centre.
/// The content is what the tracer's engine has prepared: ViewRenderer::query_for says what to ask providers
/// for. Errors: bad_input.
[[nodiscard]] Status trace_picture(LightTracer& tracer, const LightPictureRequest& request, ViewPicture& out);

}  // namespace rigor::render
