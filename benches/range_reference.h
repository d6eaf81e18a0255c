// References of LiDARs and time-of-flight cameras: what a device measures, without noise, where its footprint
// or pixel is integrated by kReferenceRays rays a pass over everything in full.
//
// A pass draws its rays by itself, so that the passes' scatter is the error of the reference. Echoes,
// detection, phases and limits are those of the device's model: what differs from a simulator is the integral
// alone.
#pragma once

#include <Eigen/Geometry>
#include <memory>
#include <vector>

#include "sensor-hal/models/lidar/lidar_model.h"
#include "sensor-hal/models/tof/tof_model.h"
#include "sim/render/rays/embree_engine.h"
#include "sim/sensors/tof/tof_light.h"

namespace rigor::bench {

/// Rays of a firing or pixel in each pass.
constexpr int kReferenceSide = 32, kReferenceRays = kReferenceSide * kReferenceSide;

/// What a device says of a firing or pixel. NaN: no return.
struct Element {
  float range_m, remission;  ///< time of flight: amplitude, electrons
  float echoes = 0;          ///< LiDAR: 0 to 2, as many as a device with dual returns says
};

/// The device without noise, rounding, biases, ghosts, and noise by the sun: its light alone.
[[nodiscard]] models::LidarModel without_errors(models::LidarModel model, int sub_rays,
                                                int most_sub_rays = 0);
[[nodiscard]] models::TofModel without_errors(models::TofModel model, int samples);

/// Firings and pixels that a reference has: of several beams each fourth column, of one beam all columns; of
/// a picture each second pixel of each second row. Firings are column by column, in a column beam by beam.
[[nodiscard]] std::vector<Element> kept_firings(const models::LidarModel& model,
                                                const std::vector<Element>& all);
[[nodiscard]] std::vector<Element> kept_pixels(const models::TofModel& model,
                                               const std::vector<Element>& all);
[[nodiscard]] std::vector<std::size_t> kept_shape(const models::LidarModel& model);
[[nodiscard]] std::vector<std::size_t> kept_shape(const models::TofModel& model);

struct Reference {
  std::vector<std::vector<Element>> passes;
  std::vector<Element> all;  ///< by the rays of all passes together
};
/// Of the kept firings, at a pose. `engine` has prepared everything in full; air without drops.
/// `pattern`: rays of all footprints in place of those of the passes; empty: those. Errors: the engine's.
[[nodiscard]] Result<Reference> lidar_reference(const models::LidarModel& model,
                                                const Eigen::Isometry3d& T_world_sensor,
                                                render::EmbreeEngine& engine, int passes,
                                                const std::vector<models::SubRay>& pattern = {});
/// Of the kept pixels, likewise. `instants`: one for all taps, or one for each exposure.
[[nodiscard]] Result<Reference> tof_reference(const models::TofModel& model,
                                              std::span<const tof::Instant> instants,
                                              render::EmbreeEngine& engine, int passes);

}  // namespace rigor::bench
