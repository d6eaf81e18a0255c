// Where the pixels of a time-of-flight camera look, worked out once: directions of all samples, and what the
// lens and the illumination do to light from there.
#pragma once

#include <cstddef>
#include <vector>

#include "sensor-hal/models/philox.h"
#include "sensor-hal/models/tof/tof_model.h"

namespace rigor::tof {

/// Samples of a pixel follow each other where they are jittered: sample = pixel · n + i. Bilinear ones lie on
/// a lattice of s per pixel and side (n = s²) with a margin of one all round: row by row,
/// (s · width + 2) × (s · height + 2).
struct SampleRays {
  int width_px = 0, height_px = 0, side = 1;  ///< side: s
  bool lattice = false;
  std::vector<float> x, y, z;  ///< unit direction, optical frame; NaN where no ray of the lens comes
  std::vector<float>
      gain;  ///< electrons of one integration per W m⁻² sr⁻¹ of radiance; 0 where there is no ray
  std::vector<float> intensity_w_per_sr;  ///< of the illumination in this direction

  [[nodiscard]] std::size_t count() const { return x.size(); }
  [[nodiscard]] int lattice_width() const { return side * width_px + 2; }
  /// The sample nearest to the middle of a pixel.
  [[nodiscard]] std::size_t middle_sample(std::size_t pixel) const;
  /// The pixel that a sample lies in; of the margin, the nearest.
  [[nodiscard]] std::size_t pixel_of(std::size_t sample) const;
};

/// The samples of the model's sampling; the jitter is a fixed pattern of the channel.
[[nodiscard]] SampleRays sample_rays(const models::TofModel& model, models::PhiloxKey key);
/// One sample in the centre of each pixel.
[[nodiscard]] SampleRays centre_rays(const models::TofModel& model);

}  // namespace rigor::tof
