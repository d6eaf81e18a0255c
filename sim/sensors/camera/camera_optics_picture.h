// The picture on the sensor's surface: for every pixel the light that the lens puts there during the
// exposure, before anything electrical. Made by one of two engines:
//
//   vulkan   pinhole views (sim/render/view), sampled through the lens: distortion, chromatic aberration,
//   depth of
//            field from the depth, motion blur and rolling shutter from views at several instants
//   rays     for every pixel rays through its area, the aperture, the exposure: the same by brute force
#pragma once

#include <Eigen/Geometry>
#include <memory>
#include <mutex>
#include <optional>
#include <vector>

#include "rt-core/result.h"
#include "sensor-hal/models/camera_model.h"
#include "sim/render/engine/content_window.h"
#include "sim/render/rays/light_tracer.h"
#include "sim/render/view/view_renderer.h"
#include "sim/sensors/measurement.h"

namespace rigor {

/// Row by row, 4 bands a pixel (red, green, blue, 850 nm), W/(m² sr), mean over the pixel and its exposure. A
/// pixel that no ray of the lens reaches is 0. Without vignetting, which is the sensor stage's.
struct OpticsPicture {
  int width_px = 0, height_px = 0;
  std::vector<float> radiance;
};

/// rays: how many rays a pixel takes, over its area, the aperture and the exposure together. The
/// default is indoors nearer than four in every pixel, at two fifths of the cost (docs/light-error.md). 1 to
/// 65536, then 0 to 4096.
struct PixelSamples {
  int every = 1;  ///< in every pixel
  /// More in pixels that differ from a neighbour by more than 0.3 of the picture's mean light.
  int uneven = 7;
  /// More where surfaces lie beside the sky, and beside pixels where these find the first sky, three times
  /// over. They ask only what share of the pixel is sky, and how bright that is; the surfaces' light is that
  /// of the other samples. Not where colours are traced apart.
  int sky = 64;
  [[nodiscard]] static PixelSamples only(int every) { return {every, 0, 0}; }
};

struct OpticsOptions {
  PixelSamples samples;
  double supersampling = 1.0;     ///< vulkan: view pixels per sensor pixel along a side
  int view_samples = 4;           ///< vulkan: samples per view pixel, 1 or 4
  int instants = 4;               ///< vulkan: views during the exposure (and readout), where anything moves
  double allowed_error_px = 1.0;  ///< levels of detail; rays: of what is collected, meshes are in full
  bool shadows = true;
  int sky_rays = 0;  ///< rays: see LightQuery; 0: light is gathered at some of the points
  /// rays: lateral chromatic aberration by rays of its own for each colour, at three times the cost; off: by
  /// moving the planes of one picture, bilinearly, which blurs red and blue by up to half a pixel. Unset:
  /// from kColoursTraced samples per pixel on. Where the colours differ in focus they are always traced.
  std::optional<bool> trace_colours{};
  /// rays: 2 has one ray (times samples) for 2 x 2 pixels, at a quarter of the cost; in between the light is
  /// bilinear, so that detail of less than two pixels is gone while noise stays that of each pixel. 1 to 8.
  int pixel_step = 1;
  static constexpr int kColoursTraced = 16;
};

struct OpticsRequest {
  MeasureRequest measure{};
  double exposure_s = 0.005;
  std::uint64_t seed = 0;  ///< of the samples of the rays engine
  struct Region {
    int x_px = 0, y_px = 0, width_px = 0, height_px = 0;
    bool operator==(const Region&) const = default;
  } region{};  ///< width 0: the whole sensor. rays: only this is traced; vulkan: whole views, read here
};

/// An engine of rays and the light in its content, for any number of cameras on any threads: they take turns.
/// What a camera sees does not depend on their order.
struct SharedLight {
  /// Errors: unavailable.
  [[nodiscard]] static Result<std::shared_ptr<SharedLight>> create(
      std::shared_ptr<render::EmbreeCache> cache);
  explicit SharedLight(std::shared_ptr<render::EmbreeEngine> e) : engine(std::move(e)), tracer(engine) {}
  std::shared_ptr<render::EmbreeEngine> engine;
  render::LightTracer tracer;
  std::mutex turn;
};

class CameraOpticsPicture {
 public:
  virtual ~CameraOpticsPicture() = default;
  [[nodiscard]] virtual std::string_view engine() const = 0;
  /// Blocks; one thread at a time. Errors: bad_input, unavailable.
  [[nodiscard]] virtual Status form(const OpticsRequest& request, const render::SensorView& view,
                                    OpticsPicture& out, GroundTruth* truth = nullptr) = 0;
  /// Of the last form(): wall time in which the engine took over what is new in the content; 0: not known.
  [[nodiscard]] virtual double prepare_ms() const { return 0; }
};

/// Errors: bad_input (a model that is not valid).
[[nodiscard]] Result<std::unique_ptr<CameraOpticsPicture>> make_vulkan_optics(
    const CameraModel& camera, const OpticsOptions& options, std::shared_ptr<render::Device> device);
/// With a renderer that others draw with too, one after the other, on the same thread.
[[nodiscard]] Result<std::unique_ptr<CameraOpticsPicture>> make_vulkan_optics(
    const CameraModel& camera, const OpticsOptions& options, std::shared_ptr<render::ViewRenderer> renderer);
[[nodiscard]] Result<std::unique_ptr<CameraOpticsPicture>> make_rays_optics(
    const CameraModel& camera, const OpticsOptions& options, std::shared_ptr<render::EmbreeCache> cache);
/// With an engine that others measure with too: what one camera has prepared is there for the next one.
[[nodiscard]] Result<std::unique_ptr<CameraOpticsPicture>> make_rays_optics(
    const CameraModel& camera, const OpticsOptions& options, std::shared_ptr<SharedLight> light);

}  // namespace rigor
