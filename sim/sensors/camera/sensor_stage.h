// From the picture on the sensor's surface to the camera's output: vignetting, veiling glare and bloom,
// electrons, noise, saturation, conversion, mosaic, optional processing. Without an effect its pass is not
// run.
//
//   radiance · V(ray)                       vignetting, from the ideal ray of each pixel
//   → spread of scattered light             bloom, over the whole of the picture that is handed in
//   → electrons per second                  bands · response of the pixel's filter
//   → EMVA 1288 pixel                       shot noise, full well, DSNU, PRNU, dark current, hot pixels, read
//   → converter                             rounding, clipping
//   → median, white balance, demosaicing, gamma    where the model has them
//   → bits of the pixel format              upper bits where the format has fewer than the converter
//
// Same input, same bytes, on any number of threads.
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
  double gain_db = 0;  ///< on K: 20 dB per factor of ten
  PixelFormat format = PixelFormat::mono8;
  /// What of the full sensor is read out; width 0: all of it. `picture` has this size or that of the full
  /// sensor; then the rows and columns beside the region count for what looks beyond it (bloom, median,
  /// demosaicing), and the bytes are those of the full picture's crop. Offsets of Bayer formats are even.
  OpticsRequest::Region region{};
};

/// Radiance that is none. A band that is NaN or negative counts as 0, one above kMaxRadiance, infinity too,
/// as that.
struct SensorStageCounts {
  std::uint64_t invalid_pixels = 0;  ///< with a band that is NaN or negative
  std::uint64_t clipped_pixels = 0;
};

/// One belongs to one thread at a time; a call computes on the threads of its TBB arena.
class SensorStage {
 public:
  /// Three hundred times the sun's disc, W/(m² sr) in a band.
  static constexpr float kMaxRadiance = 1e9f;

  /// Works out the maps of the full sensor; setup. Errors: bad_input (the model).
  [[nodiscard]] static Result<std::unique_ptr<SensorStage>> create(const SensorStageSpec& spec);
  ~SensorStage();
  /// `pixels` has image_bytes(format, region) bytes. Errors: bad_input (region, sizes, exposure, gain).
  [[nodiscard]] Status expose(const SensorStageRequest& request, const OpticsPicture& picture,
                              std::span<std::byte> pixels, SensorStageCounts* counts = nullptr);
  /// Planes that expose_rates() takes for a format: 1 of a mono camera and of a mosaic (each pixel's own
  /// colour), else 3.
  [[nodiscard]] std::size_t rate_planes(PixelFormat format) const;
  /// From light that is already counted: mean electrons per second before vignetting, rate_planes() times the
  /// region's pixels. Errors as expose(); bad_input too for a camera with bloom, which needs every colour.
  [[nodiscard]] Status expose_rates(const SensorStageRequest& request, std::span<const float> rates,
                                    std::span<std::byte> pixels);

 private:
  struct Impl;
  struct Light;
  [[nodiscard]] Status expose_light(const SensorStageRequest& request, const Light& light,
                                    std::span<std::byte> pixels, SensorStageCounts* counts);
  explicit SensorStage(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace rigor
