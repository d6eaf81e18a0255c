// A frame as a picture: a row for each beam from the top, a column for each column of a turn, from left to
// right in the sense of its rotation (clockwise seen from above). The middle of the picture looks forward.
// Beams of one column point to different azimuths, so each row is shifted by its pixel_shift_by_row: what is
// vertical in the world is vertical in the picture. The first return of a pixel counts.
//
//   signal, near_infrared, reflectivity   an image: the sensor's numbers in 16 bits, or scaled to 8
//   range                                 a range image: metres from the lidar's origin (NaN: no return), and
//                                         as amplitude the signal, or the reflectivity where the profile has
//                                         no signal
//
// Pixels that did not come, and those outside of the azimuth window, are 0 (NaN).
#pragma once

#include <cstddef>
#include <optional>
#include <span>
#include <string_view>
#include <vector>

#include "drivers/ouster/lidar_packet.h"
#include "sensor-hal/types/sample.h"

namespace rigor::ouster {

/// What a sensor measures of a pixel.
enum class Field : std::uint8_t { reflectivity, signal, near_infrared, range };
/// "signal", …
[[nodiscard]] std::optional<Field> field_named(std::string_view name);
/// bad_input: packets of this profile do not have the field.
[[nodiscard]] Status check_field(Profile profile, Field field);

struct ImageOptions {
  Field field = Field::signal;
  PixelFormat format = PixelFormat::mono16;  ///< mono8 or mono16; of a range image without meaning
  double full_scale = 255;                   ///< of mono8: the number that becomes 255
};

/// Setup: create, copy. The rest: one thread, no allocation.
class FrameImage {
 public:
  FrameImage(const Metadata& metadata, const ImageOptions& options);
  /// As if nothing had come.
  void clear();
  /// Precondition: column < W, row < rows.
  void set(std::uint32_t column, std::uint32_t row, const Pixel& first_return, std::uint16_t near_infrared);

  /// ImageInfo or RangeImageInfo.
  [[nodiscard]] const decltype(Sample::info)& info() const { return info_; }
  [[nodiscard]] std::span<const std::uint8_t> bytes() const { return bytes_; }
  [[nodiscard]] const ImageOptions& options() const { return options_; }
  [[nodiscard]] std::uint32_t width_px() const { return width_; }
  [[nodiscard]] std::uint32_t height_px() const { return static_cast<std::uint32_t>(shift_.size()); }

 private:
  ImageOptions options_;
  std::uint32_t width_;
  bool has_signal_ = true;
  std::vector<std::uint32_t> shift_;  ///< by row, from 0 to W − 1
  decltype(Sample::info) info_;
  std::vector<std::uint8_t> bytes_;
};

}  // namespace rigor::ouster
