// What has changed between a camera and its simulated side, from pictures of the same instants.
//
// Pictures are averaged into a grid of cells (sums of whole numbers, hence exact). The residual of a cell,
// real − simulated, is regressed on
//
//   gain             simulated − black                      relative
//   offset           1                                      DN
//   focal length     −∇I · flow of a longer focal length    relative
//   mount x, y, z    −∇I · flow of a turn of the camera     rad, about the axes of its optical frame
//   tile c,r         simulated − black within a tile        relative, apart from the gain: dirt, vignetting
//
// with ∇I the mean of both pictures' gradients, which makes the linearisation one of second order (Benhimane
// and Malis, IROS 2004). Flows go through the whole lens model. A turn and a shift of the principal point
// look alike: the first stands for both. So do, in scenes far away, a turn and a move across the line of
// sight.
//
// Where a thing near the camera shifts by parallax that the simulated side's world does not have, its
// residuals stand out: weights fall with the gradient (misfit_px), and Huber's weights (c = 1.345) limit what
// is left.
//
// Noise is what the 3×3 operator [1 −2 1; −2 4 −2; 1 −2 1] leaves of the difference of both pictures
// (Immerkær, CVIU 64, 1996), at places where the simulated side's picture is smooth: variance over that of
// the camera's model, as excess of the real side if the simulated side's noise is that of the model. Over all
// (`noise`), and by brightness against that (`noise dark`, `middle`, `bright`: below 1/8, 3/8, all of the
// range above black).
//
// Not looked at: cells with a saturated or black pixel, gamma and other processing (their effect on the noise
// is in the baseline), colour: of RGB the green, of YUV the luma, of mosaics the cell's mean.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "rt-core/result.h"
#include "sensor-hal/channel/pair_watch/feature_shift.h"
#include "sensor-hal/channel/pair_watch/noise_sums.h"
#include "sensor-hal/channel/pair_watch/robust_fit.h"
#include "sensor-hal/channel/pair_watch/window_fit.h"
#include "sensor-hal/models/camera_model.h"
#include "sensor-hal/types/sample.h"

namespace rigor::pair_watch {

struct ImageChangeOptions {
  std::size_t cells = 4096;  ///< at most this many, roughly; more see finer and cost more
  int tiles_across = 3, tiles_down = 2;
  double misfit_px = 0.05;  ///< edges may be off by this much without meaning anything
};

class ImageChange {
 public:
  /// Setup; allocates all there will be. `shape`: format, size and place on the full sensor of the pictures
  /// to come. bad_input: options, a format that is depth, a picture outside of the sensor, too small for 8×8
  /// cells.
  [[nodiscard]] static Result<ImageChange> make(const CameraModel& camera, const ImageInfo& shape,
                                                const ImageChangeOptions& options = {});

  [[nodiscard]] const std::vector<Parameter>& parameters() const noexcept { return parameters_; }

  /// A cell of the regression: residual real − simulated in DN, its derivatives by gain, offset, focal length
  /// and the three turns, mean gradient of both pictures, light of the simulated one above black.
  struct Row {
    double residual, base_weight, weight, derivative[6], lit;
    std::uint32_t tile, field;  ///< fields are half as wide and as high as tiles
    float gradient[2];          ///< DN/px
    std::uint32_t cell;         ///< place in the grid, row by row
  };

  // One thread at a time; no allocation.
  /// Of the last pair; empty where it said nothing.
  [[nodiscard]] std::span<const Row> rows() const noexcept { return rows_; }
  [[nodiscard]] std::size_t cells_across() const noexcept { return across_; }
  [[nodiscard]] std::size_t cells_down() const noexcept { return down_; }
  [[nodiscard]] std::size_t cell_side_px() const noexcept { return side_; }
  /// Variance of one side's pixel at a value, DN² of the format.
  [[nodiscard]] double variance_at(double dn) const noexcept;
  /// False: not pictures of the shape, or one is incomplete; nothing has happened.
  bool add(const Sample& real, const Sample& simulated) noexcept;
  /// What the pictures since the last call say; starts the next window.
  void finish(Estimate& estimate) noexcept;

 private:
  struct Flow {
    float focal[2], turn[3][2];  ///< pixels for each unit of the parameter
  };
  struct Cell {
    std::uint64_t real = 0, simulated = 0;
    std::uint32_t count = 0;
    bool bad = false;
  };
  ImageChange(const CameraModel& camera, const ImageInfo& shape, const ImageChangeOptions& options);
  template <class Load>
  void read(const Load& real, const Load& simulated) noexcept;
  void regress() noexcept;
  [[nodiscard]] double shift_px(const Estimate& estimate) const noexcept;

  ImageInfo shape_;
  ImageChangeOptions options_;
  std::vector<Parameter> parameters_;
  EmvaNoise noise_;
  double base_gain_ = 1, gain_ = 1, black_ = 0, scale_ = 1, max_ = 255;
  std::size_t side_ = 1, across_ = 0, down_ = 0, row_step_ = 1, pitch_ = 1, noise_step_ = 3;
  std::vector<Flow> flow_;
  std::vector<std::uint8_t> has_flow_;
  std::vector<Cell> cells_;
  std::vector<Row> rows_;
  RobustFit fit_;
  FeatureShift features_;
  NoiseSums noise_sums_;
};

}  // namespace rigor::pair_watch
