// What a perfect camera would have known of every pixel. Internal to sim/sensors/camera.
#pragma once

#include "sim/render/engine/ray_engine.h"
#include "sim/sensors/camera/exposure_timing.h"
#include "sim/sensors/camera/lens_grid.h"
#include "sim/sensors/measurement.h"

namespace rigor {

struct TruthRequest {
  const CameraModel& camera;
  const LensGrid& lens;  ///< of kReferenceChannel
  OpticsRequest::Region region;
  const ExposureTiming& timing;
  const SensorMotion& motion;
};

/// At the centre of every pixel and the middle of its row's exposure. The engine has the window prepared that
/// `timing` spans. A direction that meets nothing flows as what is infinitely far away; a pixel that no ray
/// reaches has NaN there. Errors: those of the engine.
[[nodiscard]] Status measure_truth(const TruthRequest& request, render::RayEngine& engine,
                                   const render::ContentWindow& window, const render::SensorView& view,
                                   GroundTruth& out);

}  // namespace rigor
