// By which engine a simulated sensor measures, and how much work it may make of it: what a rig writes, what
// `rigor tune` chooses, what a lock file keeps.
//
//   renderer: rays                   rays | raster; cameras also: scene
//   quality:
//     allowed_error_rad: 0.001       levels of detail whose error subtends less may stand for the finest; 0
//     sub_rays: 5                    LiDAR: rays per beam; the sensor's own where it is not given
//     samples_per_pixel: 4           time of flight (rays per pixel); the sensor's own. Cameras by rays; 1
//     pixel_step: 2                  cameras by rays: one ray (times samples) for 2 x 2 pixels; 1
//     uneven_samples: 4              cameras by rays: samples more in pixels that differ much
//     sky_samples: 16                cameras by rays: rays more where things lie beside the sky
//     sky_rays: 1                    cameras by rays: rays per sample that ask which sky is hidden; 0
//     pixels_per_rad: 800            raster, LiDAR and time of flight: resolution of the views
//     supersampling: 1               raster, cameras: view pixels per sensor pixel along a side
//     instants: 2                    raster: views while something moves
#pragma once

#include <optional>
#include <string>

#include "sensor-hal/config/yaml.h"
#include "sensor-hal/types/sample.h"

namespace rigor {

/// Draws cameras in worlds of boxes, cylinders and flat ground, in closed form.
inline constexpr const char* kSceneRenderer = "scene";

struct EngineChoice {
  std::string engine;  ///< scene | rays | raster; empty: nobody chose
  double allowed_error_rad = 0;
  int sub_rays = 0;           ///< 0: of the sensor
  int samples_per_pixel = 0;  ///< 0: of the sensor, of a camera one
  int pixel_step = 0;         ///< 0: every pixel
  /// Unset: none where samples_per_pixel is given, else the camera's.
  std::optional<int> uneven_samples{}, sky_samples{};
  int sky_rays = 0;           ///< 0: light is gathered at some of the points
  double pixels_per_rad = 0;  ///< 0: the engine's default
  double supersampling = 0;   ///< 0: of the sensor
  int instants = 0;           ///< 0: the engine's default

  bool operator==(const EngineChoice&) const = default;
  /// "rays, 5 sub-rays, allowed error 1 mrad".
  [[nodiscard]] std::string text() const;
  /// As YAML in one line: `{ renderer: rays, sub_rays: 5 }`.
  [[nodiscard]] std::string yaml() const;
};

/// Reads `renderer` and `quality` of a simulated channel; `quality` without `renderer` is of rays. Throws
/// ConfigError.
[[nodiscard]] EngineChoice read_engine_choice(ConfigNode params, SampleKind kind);
/// Reads what `yaml` wrote.
[[nodiscard]] EngineChoice read_locked_choice(ConfigNode n);

}  // namespace rigor
