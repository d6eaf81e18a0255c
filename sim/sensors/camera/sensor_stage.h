// From the picture on the sensor's surface to the camera's output: vignetting, veiling glare and bloom,
// electrons, noise, saturation, conversion, mosaic, optional processing. Without an effect its pass is not
// run.
//
// Same input, same bytes, on any number of threads. The GPU's sensor pass (sim/render/shaders/sensor.comp)
// draws from the same model files and the same counters.
#pragma once

#include <cstddef>
#include <memory>
#include <span>

#include "rt-core/result.h"
#include "sensor-hal/models/camera_model.h"
#include "sensor-hal/types/pixel_format.h"
#include "sim/sensors/camera/camera_optics_picture.h"

namespace rigor {

struct SensorStageSpec {
  std::string name;  ///< keys the noise, with the seed
  CameraModel model;
  std::uint64_t seed = 0;
  bool noise = true;
};
struct SensorStageRequest {
  std::uint64_t capture_index = 0;
  double exposure_s = 0.005;
  double gain_db = 0;
  PixelFormat format = PixelFormat::mono8;
  OpticsRequest::Region region{};  ///< of `picture` in the full sensor; width 0: all of it
};

class SensorStage {
 public:
  /// Errors: bad_input.
  [[nodiscard]] static Result<std::unique_ptr<SensorStage>> create(const SensorStageSpec& spec);
  ~SensorStage();
  /// `pixels` has image_bytes(format, region) bytes.
  [[nodiscard]] Status expose(const SensorStageRequest& request, const OpticsPicture& picture,
                              std::span<std::byte> pixels);

 private:
  struct Impl;
  explicit SensorStage(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace rigor
