// Pictures of a scene as one camera takes them: a raster pass draws the ideal linear-light picture of a
// pinhole that sees slightly more than the lens, a compute pass applies the lens, vignetting, exposure,
// noise, saturation, quantisation and packing. What has no effect has no code in the pipelines: noise of
// zero, highlights on a scene that is matt, the texture of a plain ground, supersampling of 1.
//
// A Renderer belongs to one thread at a time (it may move between threads); several coexist, on one device or
// more. The same request gives the same bytes, from call to call and from any thread (same binary, driver and
// CPU type).
#pragma once

#include <Eigen/Geometry>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "rt-core/result.h"
#include "rt-core/time.h"
#include "sensor-hal/models/camera_model.h"
#include "sensor-hal/models/philox.h"
#include "sensor-hal/types/pixel_format.h"
#include "sim/render/device.h"
#include "sim/world/scene.h"

namespace rigor::render {

struct RendererOptions {
  CameraModel camera;
  PixelFormat format = PixelFormat::mono8;
  /// Picture pixels per sensor pixel, along one side, on the axis: 1 to 4.
  double supersampling = 1.0;
  /// Off: no draw at all. What stays is deterministic: dark current's mean, saturation, rounding.
  bool noise = true;
  models::PhiloxKey key;  ///< of the noise: models::channel_key(seed, channel)
};

struct Region {
  int offset_x_px = 0, offset_y_px = 0, width_px = 0, height_px = 0;
  bool operator==(const Region&) const = default;
};

struct PictureRequest {
  Eigen::Isometry3d T_world_sensor = Eigen::Isometry3d::Identity();  ///< optical frame
  BenchTime t_capture;                                               ///< instant whose poses are drawn
  double exposure_s = 0.01;
  double gain = 1.0;  ///< factor on the system gain K
  std::uint64_t capture_index = 0;
  Region region;
};

/// Wall time of the stages of one call. Asking for them splits the work into two submissions.
struct StageTimes {
  double geometry_ms = 0;  ///< poses, culling, lists, upload
  double raster_ms = 0;
  double sensor_ms = 0;
  double copy_ms = 0;
};

/// The ideal picture before the lens, for tests and for what measures light without a camera.
struct LinearPicture {
  int width_px = 0;
  int height_px = 0;
  int channels = 0;                         ///< 1, or 4 of which red, green and blue are in use
  std::vector<float> electrons_per_second;  ///< row by row
  double focal_x_px = 0, focal_y_px = 0, centre_u_px = 0, centre_v_px = 0;
};

class Renderer {
 public:
  /// Builds pipelines and the lens map, and draws once so that the first picture is as quick as the others.
  /// Setup; the scene must be valid. Errors: bad_input (the camera model; a lens wider than a pinhole picture
  /// can hold), unavailable (the device).
  [[nodiscard]] static Result<std::unique_ptr<Renderer>> create(std::shared_ptr<Device> device,
                                                                std::shared_ptr<const world::Scene> scene,
                                                                const RendererOptions& options);
  ~Renderer();
  Renderer(const Renderer&) = delete;
  Renderer& operator=(const Renderer&) = delete;

  /// Draws into `pixels_out`, image_bytes(format, region) long, rows without padding. Blocks for
  /// milliseconds: not for the loop. Errors: bad_input (region, size of the output, exposure, gain,
  /// snapshot), unavailable (the device).
  [[nodiscard]] Status draw(const PictureRequest& request, const world::WorldSnapshot& snapshot,
                            std::span<std::byte> pixels_out, StageTimes* times = nullptr);

  /// The raster pass alone, read back. Setup and tests.
  [[nodiscard]] Result<LinearPicture> draw_linear(const PictureRequest& request,
                                                  const world::WorldSnapshot& snapshot);

  /// What the set-up shader made of the lens: per pixel of the sensor x, y (ideal ray), gain, offset [e-].
  [[nodiscard]] std::vector<std::array<float, 4>> lens_map() const;

  struct Impl;

 private:
  explicit Renderer(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace rigor::render
