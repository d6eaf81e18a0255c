// A simulated camera of a small scene: where it sits, what lens and sensor it has, a renderer that measures
// the light and a sensor stage that makes numbers of it, both on the CPU.
//
//   auto camera = CameraSimulator::create(spec, scene);
//   std::vector<std::byte> pixels((*camera)->full_region_bytes());
//   Status s = (*camera)->capture({.capture_index = 0, .t_capture = t, .exposure = milliseconds(4)},
//   snapshot, pixels);
//
// A capture is a function of its request, its snapshot and the spec alone: same in, same bytes out, whichever
// thread asks and whatever was asked before.
#pragma once

#include <Eigen/Geometry>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "rt-core/result.h"
#include "rt-core/time.h"
#include "sensor-hal/models/camera_model.h"
#include "sensor-hal/types/pixel_format.h"
#include "sim/render/scene/scene_renderer.h"
#include "sim/sensors/camera/sensor_stage.h"
#include "sim/world/scene.h"

namespace rigor {

struct CameraSpec {
  std::string name;  ///< the channel's name: its noise depends on it and on the seed
  CameraModel model;
  PixelFormat format = PixelFormat::mono8;
  bool noise = true;  ///< off: the ideal picture, quantised
  std::uint64_t seed = 0;
  std::optional<std::string> parent_node;  ///< node that carries the camera; empty: it stands in the world
  /// Optical frame (x right, y down, z forward) in the parent's frame.
  Eigen::Isometry3d T_parent_sensor = Eigen::Isometry3d::Identity();
};

struct CaptureRequest {
  std::uint64_t capture_index = 0;  ///< keys the noise
  BenchTime t_capture{};            ///< middle of the exposure; the world stands still during one picture
  Duration exposure = milliseconds(5);
  double gain_db = 0.0;     ///< on the system gain K, 20 dB per factor of ten
  render::Region region{};  ///< width 0: the whole sensor
};

class CameraSimulator {
 public:
  /// Setup. The scene must be valid. Errors: bad_input (spec, unknown parent node, bloom).
  [[nodiscard]] static Result<std::unique_ptr<CameraSimulator>> create(
      const CameraSpec& spec, std::shared_ptr<const world::Scene> scene);

  /// One picture, rows without padding: `pixels_out` has image_bytes(format, region) bytes. Blocks for
  /// milliseconds; one thread at a time. A small picture is worked out on the calling thread alone, a large
  /// one on those of its TBB arena. Errors: bad_input (region, sizes, exposure, gain, snapshot).
  [[nodiscard]] Status capture(const CaptureRequest& request, const world::WorldSnapshot& snapshot,
                               std::span<std::byte> pixels_out);

  [[nodiscard]] const CameraSpec& spec() const { return spec_; }
  [[nodiscard]] const world::Scene& scene() const { return *scene_; }
  [[nodiscard]] std::size_t full_region_bytes() const;
  [[nodiscard]] Eigen::Isometry3d T_world_sensor(const world::WorldSnapshot& snapshot, BenchTime t) const;

  /// Ground truth: where a point of the world appears on the full sensor; empty where the lens does not image
  /// it. Says nothing about what stands before it. Any thread.
  [[nodiscard]] std::optional<PixelPosition> project_world(const Eigen::Vector3d& p_world,
                                                           const world::WorldSnapshot& snapshot,
                                                           BenchTime t) const;
  /// The inner corners of a body's chessboard, row by row; each may lie outside the sensor. Empty list: no
  /// board.
  [[nodiscard]] std::vector<std::optional<PixelPosition>> project_chessboard(
      std::size_t body, const world::WorldSnapshot& snapshot, BenchTime t) const;

  [[nodiscard]] render::SceneRenderer& renderer() { return *renderer_; }

 private:
  CameraSimulator() = default;
  Status expose(const CaptureRequest& request, const world::WorldSnapshot& snapshot,
                std::span<std::byte> pixels_out);
  CameraSpec spec_;
  std::shared_ptr<const world::Scene> scene_;
  std::optional<std::size_t> parent_;
  std::unique_ptr<render::SceneRenderer> renderer_;
  std::unique_ptr<SensorStage> sensor_;
  std::vector<float> rates_;  ///< kept between calls
};

/// Pose of an optical frame at `eye` that looks at `target` with `up` towards the picture's top.
/// Precondition: the three directions are not parallel and eye is not target.
[[nodiscard]] Eigen::Isometry3d look_at(const Eigen::Vector3d& eye, const Eigen::Vector3d& target,
                                        const Eigen::Vector3d& up = Eigen::Vector3d::UnitZ());

}  // namespace rigor
