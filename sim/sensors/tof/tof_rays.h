// Where the pixels of a time-of-flight camera look, worked out once: directions of all samples, and what the
// lens and the illumination do to light from there.
#pragma once

#include <cmath>
#include <cstddef>
#include <vector>

#include "sensor-hal/models/one_source.h"
#include "sensor-hal/models/philox.h"
#include "sensor-hal/models/tof/tof_model.h"

namespace rigor::tof {

/// Samples of a pixel follow each other where they are jittered: sample = pixel · n + i. Bilinear ones lie on
/// a lattice of s per pixel and side (n = s²) with a margin of one all round: row by row,
/// (s · width + 2) × (s · height + 2).
struct SampleRays {
  int width_px = 0, height_px = 0, side = 1;  ///< side: s
  bool lattice = false;
  std::vector<float> x, y, z;     ///< unit direction, optical frame; NaN where no ray of the lens comes
  std::vector<float> u_px, v_px;  ///< where it lies in the picture, from the upper left corner
  std::vector<float>
      gain;  ///< electrons of one integration per W m⁻² sr⁻¹ of radiance; 0 where there is no ray
  std::vector<float> intensity_w_per_sr;  ///< of the illumination in this direction

  [[nodiscard]] std::size_t count() const { return x.size(); }
  [[nodiscard]] std::size_t pixels() const {
    return static_cast<std::size_t>(width_px) * static_cast<std::size_t>(height_px);
  }
  /// Samples of a pixel where they are jittered.
  [[nodiscard]] std::size_t each() const { return static_cast<std::size_t>(side * side); }
  [[nodiscard]] int lattice_width() const { return side * width_px + 2; }
  /// The sample nearest to the middle of a pixel.
  [[nodiscard]] std::size_t middle_sample(std::size_t pixel) const;
  /// The pixel that a sample lies in; of the margin, the nearest.
  [[nodiscard]] std::size_t pixel_of(std::size_t sample) const;
};

/// What the lens and the illumination do to light by its angle to the axis.
class OffAxis {
 public:
  explicit OffAxis(const models::TofModel& model);
  /// SampleRays::gain.
  [[nodiscard]] float gain(float cosine) const {
    return electrons_per_radiance_ *
           models::LensMath<float>::natural_vignetting(cosine * cosine, cos4_weight_);
  }
  [[nodiscard]] float intensity_w_per_sr(float cosine) const {
    if (exponent_ == 0) return on_axis_w_per_sr_;
    return on_axis_w_per_sr_ * (exponent_ == 1 ? cosine : std::pow(cosine, exponent_));
  }

 private:
  float electrons_per_radiance_, cos4_weight_, on_axis_w_per_sr_, exponent_;
};

/// The samples of the model's sampling; the jitter is a fixed pattern of the channel.
[[nodiscard]] SampleRays sample_rays(const models::TofModel& model, models::PhiloxKey key);
/// One sample in the centre of each pixel.
[[nodiscard]] SampleRays centre_rays(const models::TofModel& model);

/// All that a camera may cast.
struct CameraRays {
  SampleRays samples;
  SampleRays middles;  ///< one through the middle of each pixel
};

}  // namespace rigor::tof
