// Pictures of an even, steady light (or of none), gathered into levels: all frames of one exposure time,
// light and temperature. A level keeps sums for each pixel, not the frames.
#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <span>
#include <string>
#include <vector>

#include "rt-core/result.h"

namespace rigor::calibration {

/// One picture and how it was taken.
struct PhotonFrame {
  std::string name;
  double exposure_s = 0;
  bool light = false;
  double temperature_c = std::numeric_limits<double>::quiet_NaN();  ///< of the sensor; NaN: not known
  double gain_db = 0;
};

struct PhotonLevel {
  PhotonFrame settings;  ///< of its first frame
  std::vector<std::string> frames;
  std::vector<std::uint32_t> sum;  ///< of each pixel over the frames
  std::vector<std::uint64_t> square;
  std::vector<std::uint16_t> least, most;
  std::vector<std::uint16_t> last;  ///< the last frame itself
  /// Mean of each frame, for each of the four places of a 2x2 mosaic (row-major).
  std::vector<std::array<double, 4>> frame_mean;
  std::vector<std::uint64_t> hashes;
  [[nodiscard]] int count() const { return static_cast<int>(frames.size()); }
  /// `light 2 ms`, `dark 0.5 ms at 40 °C`.
  [[nodiscard]] std::string text() const;
};

class FrameStacks {
 public:
  /// Row by row, values in the low bits. A frame that equals another of its level bit by bit is a copy: it is
  /// left out and named in `copies` (one that is the same everywhere, all black or all white, is none).
  /// bad_input: another size than before, an exposure that is none.
  [[nodiscard]] Status add(const PhotonFrame& frame, std::span<const std::uint16_t> pixels, int width_px,
                           int height_px);

  [[nodiscard]] int width_px() const { return width_px_; }
  [[nodiscard]] int height_px() const { return height_px_; }
  /// In order of light, temperature, exposure. One gain only: that of most frames; see `other_gain`.
  [[nodiscard]] const std::vector<PhotonLevel>& levels() const { return levels_; }
  [[nodiscard]] const std::vector<std::string>& copies() const { return copies_; }
  /// Greatest common divisor of all values: 16 for 12 bits that were shifted to the top of a word.
  [[nodiscard]] int step() const;
  [[nodiscard]] int largest() const { return largest_; }

 private:
  int width_px_ = 0, height_px_ = 0, largest_ = 0;
  std::string first_;
  std::vector<PhotonLevel> levels_;
  std::vector<std::string> copies_;
  std::vector<bool> seen_ = std::vector<bool>(65536, false);
};

}  // namespace rigor::calibration
