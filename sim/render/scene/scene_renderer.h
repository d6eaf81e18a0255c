// Pictures of a small scene as one camera's lens shows them, on the CPU: the light that the ray of each pixel
// brings through the lens, averaged over the pixel. Patterns are averaged by formula; where neighbouring
// pixels see different faces, or one of them a shadow, eight rays are. What the sensor makes of the light is
// the sensor stage's (sim/sensors/camera).
//
// A SceneRenderer belongs to one thread at a time (it may move between threads) and computes on the threads
// of its TBB arena. The same request gives the same light on any number of them, by AVX2 and without.
#pragma once

#include <Eigen/Geometry>
#include <array>
#include <memory>
#include <span>
#include <vector>

#include "rt-core/result.h"
#include "rt-core/time.h"
#include "sensor-hal/models/camera_model.h"
#include "sim/world/scene.h"

namespace rigor::render {

enum class SceneColours {
  mono,    ///< one plane
  mosaic,  ///< one plane, each pixel's own colour: red first, as in BayerRG
  rgb      ///< three planes
};

struct SceneRendererOptions {
  CameraModel camera;
  SceneColours colours = SceneColours::mono;
};

struct Region {
  int offset_x_px = 0, offset_y_px = 0, width_px = 0, height_px = 0;
  bool operator==(const Region&) const = default;
};

struct PictureRequest {
  Eigen::Isometry3d T_world_sensor = Eigen::Isometry3d::Identity();  ///< optical frame
  BenchTime t_capture;                                               ///< instant whose poses are drawn
  Region region;
};

class SceneRenderer {
 public:
  /// Setup; the scene must be valid. Errors: bad_input (the camera model; a fisheye lens; too many bodies).
  [[nodiscard]] static Result<std::unique_ptr<SceneRenderer>> create(
      std::shared_ptr<const world::Scene> scene, const SceneRendererOptions& options);
  ~SceneRenderer();

  /// Planes of a picture.
  [[nodiscard]] std::size_t planes() const;
  /// Mean electrons per second of each pixel of the region, without vignetting: planes() times
  /// region.width_px times region.height_px numbers. Blocks for milliseconds: not for the loop. Errors:
  /// bad_input (region, sizes, snapshot).
  [[nodiscard]] Status draw(const PictureRequest& request, const world::WorldSnapshot& snapshot,
                            std::span<float> electrons_per_second);

  /// The ideal ray (x/z, y/z) of each pixel of the sensor; no number where the lens images none.
  [[nodiscard]] std::vector<std::array<float, 2>> rays() const;

 private:
  struct Impl;
  explicit SceneRenderer(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace rigor::render
