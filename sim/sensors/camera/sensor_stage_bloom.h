// Light that the lens and the sensor's cover spread over the picture (models/bloom.glsl.h), fast and with all
// of its energy.
//
// The kernel is a sum of Gaussians, two to an octave of width. Narrow ones are convolved with the picture
// itself, wide ones with pictures of half, a quarter, … of its size: light is summed up on the way down and
// spread by the transposed weights on the way up. So the operator K is symmetric, and one positive number per
// pixel, d, with d (K d) = 1 makes D K D doubly stochastic (Sinkhorn and Knopp): every pixel gives away
// exactly its light, and even light stays even. What would fall beyond the picture's border is thus given to
// the pixels that the kernel reaches within it, as if as much came in from outside as goes out.
//
// Internal to the sensor stage.
#pragma once

#include <vector>

#include "sensor-hal/models/camera_model.h"

namespace rigor::sensor_stage {

class BloomOperator {
 public:
  /// Setup: some tens of milliseconds for a megapixel. `bloom` is valid and active.
  BloomOperator(int width_px, int height_px, const Bloom& bloom);

  /// In place, row by row. One thread at a time; computes on all threads of the arena.
  void apply(std::vector<float>& plane);

  [[nodiscard]] int width_px() const { return width_; }
  [[nodiscard]] int height_px() const { return height_; }

 private:
  struct Filter {
    std::vector<float> row, column;  ///< taps from the centre outwards; symmetric
  };
  struct Level {
    int width = 0, height = 0;
    std::vector<Filter> filters;
    std::vector<float> light, spread;
  };
  void spread();  ///< levels_[0].spread = K levels_[0].light
  int width_, height_;
  Bloom bloom_;
  float constant_ = 0;  ///< the Gaussians that are wider than everything: light that falls evenly
  std::vector<Level> levels_;
  std::vector<float> scratch_, balance_;
};

}  // namespace rigor::sensor_stage
