// From what rays meet to electrons: the camera's own light and the ambient light, sample by sample.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "sensor-hal/models/tof/tof_model.h"
#include "sim/render/engine/ray_engine.h"
#include "sim/sensors/tof/tof_light_math.h"
#include "sim/sensors/tof/tof_parts.h"
#include "sim/sensors/tof/tof_rays.h"
#include "sim/sensors/tof/tof_returns.h"

namespace rigor::tof {

/// Light that reaches the samples at one instant.
struct SampleLight {
  /// Pixels have the mean of what lies in them. Empty: the samples are those of SampleRays, each in its cell.
  PixelParts parts;
  std::vector<float> active_e;   ///< E of one integration; 0: nothing comes back
  std::vector<float> range_m;    ///< half the way of that light; 0 where nothing was met
  std::vector<float> ambient_e;  ///< of one integration, all taps together; empty: none anywhere
  /// Over one more surface, `rays` for each pixel; empty: none.
  std::vector<float> bounce_e, bounce_range_m;
};

/// An instant: where the sensor is and when.
struct Instant {
  Eigen::Isometry3d T_world_sensor = Eigen::Isometry3d::Identity();
  float time = 0;  ///< in the window
};

/// Index of the band that is nearest to a wavelength.
[[nodiscard]] int nearest_band(double wavelength_m);
/// What a hit sends back along its ray, relative to a white matt surface square to it: Lambert's cosine,
/// gloss, retro-reflection.
[[nodiscard]] float remission(const render::Hit& hit, double retro_gain);
/// Width of a band of content, m: docs/conventions.md, "Light".
[[nodiscard]] double band_width_m(int band);

/// Casts and works out light. Keeps its large buffers from frame to frame.
class LightMeter {
 public:
  LightMeter(const models::TofModel& model, models::PhiloxKey key);

  /// Light at each of `instants`; `window` is what the engine has prepared.
  ///
  /// Jittered samples: each pixel has one first, at one of the instants, and the others where it and its
  /// neighbours' do not say what all would. What was met comes back at the other instants, where it lies in
  /// the picture then; that something else hides it from there is not asked. Pixels that see something that
  /// moves, and those beside them, have all samples cast at each instant, and so have those that see nothing
  /// of the others'. Whether the sun reaches a pixel is asked once.
  ///
  /// Samples on a lattice and models with light over several ways: all are cast at each instant, and the sun
  /// is asked for again where what is met is no longer the same place. Engines without own origins measure
  /// each instant by itself. Errors: the engine's.
  [[nodiscard]] Status measure(render::RayEngine& engine, const render::ContentWindow& window,
                               const CameraRays& rays, std::span<const Instant> instants,
                               std::span<SampleLight> lights);
  /// Rays only: hits of the samples at an instant, valid until the next call.
  [[nodiscard]] Result<std::span<const render::Hit>> cast(render::RayEngine& engine, const SampleRays& rays,
                                                          const Instant& instant);
  [[nodiscard]] int band() const { return band_; }

 private:
  struct Ambient {
    bool any = false;
    float sun[3]{};  ///< direction to it, world axes
    float sun_irradiance = 0, sky_irradiance = 0, ground_radiance = 0;
    float sun_cos = 2, sun_disc_radiance = 0;
    float sun_beside_cos = 2;  ///< of the disc and two pixels around it
    float share = 0;
  };
  /// Where sample i of instant k stands among rays and hits: packets of kBeside samples an instant.
  [[nodiscard]] std::size_t at(std::size_t i, std::size_t k) const {
    if (instants_ == 1) return i;
    const std::size_t first = i / kBeside * kBeside;
    return first * instants_ + k * std::min(kBeside, samples_ - first) + (i - first);
  }
  [[nodiscard]] Status cast(render::RayEngine& engine, const SampleRays& rays,
                            std::span<const Instant> instants);
  [[nodiscard]] Ambient ambient(const render::ContentFrame& frame, const SampleRays& rays);
  void active(const SampleRays& rays, std::size_t k, const Instant& instant,
              const render::ContentFrame& frame, SampleLight& light) const;
  [[nodiscard]] Status shadows(render::RayEngine& engine, const SampleRays& rays,
                               std::span<const Instant> instants, const Ambient& sky);
  /// Of the sky, the sun and lamps by way of what was met, towards the sensor at `eye`.
  [[nodiscard]] float background_radiance(const render::Hit& hit, Vector direction,
                                          const Eigen::Vector3d& eye, bool in_shade,
                                          const render::ContentFrame& frame, const Ambient& sky) const;
  void background(const SampleRays& rays, std::size_t k, const Instant& instant,
                  const render::ContentFrame& frame, const Ambient& sky, SampleLight& light) const;
  [[nodiscard]] Status bounce(render::RayEngine& engine, const SampleRays& rays, std::size_t k,
                              const Instant& instant, SampleLight& light);
  /// A sample of a pixel, and when it is cast.
  struct Shot {
    std::uint32_t pixel;
    std::uint16_t sample, instant;
    bool shared = true;  ///< what it meets comes back at the other instants
    bool whole = false;  ///< it stands for the whole pixel, else for its cell
  };
  [[nodiscard]] Status measure_shots(render::RayEngine& engine, const render::ContentWindow& window,
                                     const CameraRays& rays, std::span<const Instant> instants,
                                     const Ambient& sky, std::span<SampleLight> lights);
  void aim_first(const SampleRays& rays, std::size_t instants);
  [[nodiscard]] Status cast_shots(render::RayEngine& engine, const SampleRays& rays,
                                  std::span<const Instant> instants, std::size_t first);
  [[nodiscard]] bool dark(std::size_t shot, const SampleRays& rays) const;
  void find_plain(const SampleRays& rays, const Ambient& sky);
  [[nodiscard]] Status cast_others(render::RayEngine& engine, const SampleRays& rays,
                                   std::span<const Instant> instants);
  [[nodiscard]] Status cast_moving(render::RayEngine& engine, const render::ContentWindow& window,
                                   const SampleRays& rays, std::span<const Instant> instants);
  void move_to_middles(const CameraRays& rays, std::span<const Instant> instants);
  [[nodiscard]] Status shadows_of_shots(render::RayEngine& engine, std::span<const Instant> instants,
                                        const Ambient& sky, std::size_t first);
  void background_of_shot(std::size_t i, std::span<const Instant> instants, const render::ContentFrame& frame,
                          const Ambient& sky);
  [[nodiscard]] PicturePart part_of(const Shot& shot, const SampleRays& rays) const;
  void light_of_shots(const CameraRays& rays, std::size_t k, std::span<const Instant> instants,
                      const render::ContentFrame& frame, SampleLight& light, std::size_t first);
  void aim_at_holes(const SampleRays& rays, std::span<SampleLight> lights);
  [[nodiscard]] render::RayQuery query(const Instant& instant, std::span<const render::Ray> rays,
                                       float near_m) const;

  const models::TofModel model_;
  const models::PhiloxKey key_;
  const int band_;
  std::vector<render::Ray> rays_, more_rays_;
  static constexpr std::size_t kBeside = 4;
  std::size_t instants_ = 1, samples_ = 0;  ///< of the last cast
  std::vector<render::Hit> hits_, more_hits_;
  std::vector<Shot> shots_;                             ///< first one of each pixel
  std::vector<std::uint32_t> shot_of_px_, more_of_px_;  ///< where its first one is, and its others begin
  std::vector<Eigen::Vector3f> plane_;  ///< normal of what a pixel and its neighbours see; 0: no plane
  std::vector<float> background_;       ///< radiance of what each shot met; empty: none anywhere
  std::vector<std::uint8_t>
      dark_px_;  ///< pixels that, as all neighbours, see nothing bright enough to be measured
  std::vector<std::uint8_t> moving_px_;  ///< pixels whose samples are not shared
  Returns returns_;
  struct Scratch {
    Returns::Seen seen;
    std::vector<PicturePart> parts;
  };
  std::vector<Scratch> scratch_;  ///< of each instant
  std::vector<std::uint8_t> hidden_;
  std::vector<std::uint32_t> asked_;    ///< shots, or pixels of instants, whose shadow ray is cast
  std::vector<std::uint8_t> in_shade_;  ///< of each pixel, instant by instant
  std::uint64_t sky_serial_ = 0;
  double sky_up_ = 0;  ///< irradiance of the sky on a level plane, kept for sky_serial_
};

}  // namespace rigor::tof
