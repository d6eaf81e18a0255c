// A simulated time-of-flight camera: four taps after sensor-hal/models/tof over an engine's rays.
//
// Same request, world, pose function and spec: same picture, on any number of threads.
#pragma once

#include <memory>
#include <vector>

#include "sensor-hal/models/tof/tof_model.h"
#include "sim/render/engine/ray_engine.h"
#include "sim/sensors/measurement.h"

namespace rigor {

struct TofSpec {
  std::string name;  ///< keys the noise, with the seed
  models::TofModel model;
  std::uint64_t seed = 0;
  bool ideal = false;            ///< the ray of the pixel's centre, no errors
  double allowed_error_rad = 0;  ///< of the content that is asked for; 0: in full
};

enum class TofPixelStatus : std::uint8_t {
  valid,
  no_return,     ///< no light of the camera's own came back
  dark,          ///< amplitude below the limit
  saturated,     ///< a tap's well was full: own light, ambient light, or both
  out_of_range,  ///< of the range limits
  ambiguous,     ///< the frequencies' ranges disagree
  filtered       ///< removed as a flying pixel
};

/// Row by row. NaN: no return, for the reason that `status` states.
struct TofPicture {
  std::uint32_t width_px = 0, height_px = 0;
  std::vector<float> range_m;  ///< radial: along the pixel's ray
  std::vector<float>
      amplitude;  ///< E·C/2 in electrons, mean of the frequencies; also where there is no range
  std::vector<TofPixelStatus> status;
  std::vector<float>
      taps;  ///< 4 per pixel of the first frequency, electrons; filled where `keep_taps` asks for it
};

class TofSimulator {
 public:
  /// Errors: bad_input.
  [[nodiscard]] static Result<std::unique_ptr<TofSimulator>> create(
      const TofSpec& spec, std::shared_ptr<render::RayEngine> engine);
  ~TofSimulator();
  /// One frame; request.t_capture is the middle of the taps. The truth is that of the pixels' centres at
  /// t_capture. Where nothing moves, neither the sensor nor the world, or the model's motion is off, the
  /// taps share their light; else each exposure has its own (LightMeter::measure). Keeps its buffers and the
  /// picture's. Blocks. Errors: the engine's.
  [[nodiscard]] Status capture(const MeasureRequest& request, const render::SensorView& view,
                               TofPicture& picture, GroundTruth* truth = nullptr, bool keep_taps = false);
  [[nodiscard]] const TofSpec& spec() const;

 private:
  struct Impl;
  explicit TofSimulator(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace rigor
