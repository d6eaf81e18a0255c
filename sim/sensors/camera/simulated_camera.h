// A simulated camera: optics (which light falls on which pixel, by one of two engines) and sensor (what
// becomes of that light), joined.
//
//   auto camera = SimulatedCamera::create({.name = "left", .model = model, .engine = CameraEngine::rays},
//   {}); std::vector<std::byte> pixels((*camera)->bytes(request)); Status s = (*camera)->capture(request,
//   view, pixels);
//
// A capture is a function of its spec, its request and the world alone: same in, same bytes out, on any
// number of threads and whatever was asked before.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>

#include "sim/sensors/camera/camera_optics_picture.h"
#include "sim/sensors/camera/sensor_stage.h"

namespace rigor {

enum class CameraEngine : std::uint8_t { vulkan, rays };

struct SimulatedCameraSpec {
  std::string name;  ///< keys noise and samples, with the seed
  CameraModel model;
  PixelFormat format = PixelFormat::mono8;  ///< of captures that name none
  std::uint64_t seed = 0;
  bool noise = true;  ///< off: the ideal electrons, quantised
  CameraEngine engine = CameraEngine::vulkan;
  OpticsOptions optics{};
};

/// What engines measure with. Empty: the camera makes its own.
struct CameraEngines {
  std::shared_ptr<render::Device> device{};      ///< vulkan
  std::shared_ptr<render::EmbreeCache> cache{};  ///< rays, and ground truth of both
  std::shared_ptr<SharedLight> light{};          ///< rays, shared with other cameras; in place of `cache`
};

struct CameraCapture {
  MeasureRequest measure{};
  Duration exposure = milliseconds(5);
  double gain_db = 0;  ///< on the system gain K, 20 dB per factor of ten
  std::optional<PixelFormat> format{};
  OpticsRequest::Region region{};  ///< width 0: the whole sensor
};

/// Wall time of the stages of one capture.
struct CaptureTimes {
  double optics_ms = 0, sensor_ms = 0;
  double prepare_ms = 0;  ///< of the optics: taking over what is new in the content
};

class SimulatedCamera {
 public:
  /// Setup. Errors: bad_input (the model), unavailable (the engine).
  [[nodiscard]] static Result<std::unique_ptr<SimulatedCamera>> create(const SimulatedCameraSpec& spec,
                                                                       const CameraEngines& engines = {});
  /// With optics of the caller's own.
  [[nodiscard]] static Result<std::unique_ptr<SimulatedCamera>> create(
      const SimulatedCameraSpec& spec, std::unique_ptr<CameraOpticsPicture> optics);

  /// One picture, rows without padding: `pixels` has bytes(request) bytes. Blocks for milliseconds; one
  /// thread at a time, and the thread that may read `view`. Errors: bad_input (region, sizes, exposure, gain,
  /// a pose), unavailable (the engine).
  [[nodiscard]] Status capture(const CameraCapture& request, const render::SensorView& view,
                               std::span<std::byte> pixels, GroundTruth* truth = nullptr,
                               CaptureTimes* times = nullptr);

  [[nodiscard]] const SimulatedCameraSpec& spec() const { return spec_; }
  [[nodiscard]] std::size_t bytes(const CameraCapture& request) const;
  /// The light of the last capture.
  [[nodiscard]] const OpticsPicture& picture() const { return picture_; }

 private:
  SimulatedCamera() = default;
  SimulatedCameraSpec spec_;
  std::uint64_t optics_seed_ = 0;
  std::unique_ptr<CameraOpticsPicture> optics_;
  std::unique_ptr<SensorStage> sensor_;
  OpticsPicture picture_;
};

/// Two cameras with one trigger: one look at the world for both, and one engine.
class StereoCamera {
 public:
  /// Both by the engine of `left`. Errors: as SimulatedCamera::create.
  [[nodiscard]] static Result<std::unique_ptr<StereoCamera>> create(const SimulatedCameraSpec& left,
                                                                    const SimulatedCameraSpec& right,
                                                                    const CameraEngines& engines = {});

  struct Side {
    render::PoseFunction T_world_sensor;
    std::span<std::byte> pixels;
    GroundTruth* truth = nullptr;
  };
  /// As two captures of the same request; where the exposures of both cover the same time (same height, line
  /// time and blur), the world is collected once.
  [[nodiscard]] Status capture(const CameraCapture& request, render::ContentSource& world, const Side& left,
                               const Side& right);
  [[nodiscard]] SimulatedCamera& left() { return *left_; }
  [[nodiscard]] SimulatedCamera& right() { return *right_; }

 private:
  StereoCamera() = default;
  std::unique_ptr<SimulatedCamera> left_, right_;
};

}  // namespace rigor
