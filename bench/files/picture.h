// Pictures of samples as plain numbers.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "rt-core/result.h"
#include "sensor-hal/types/sample.h"

namespace rigor {

/// Brightness in 8 bits, row by row, of any format that has brightness. internal: fewer bytes than the size
/// says; bad_input: a picture of depths.
[[nodiscard]] Result<std::vector<std::uint8_t>> grey_picture(const ImageInfo& info,
                                                             std::span<const std::byte> bytes);
/// The sensor's own numbers in the order of the bytes (a mosaic stays one, colours are three numbers a
/// pixel). internal as above.
[[nodiscard]] Result<std::vector<double>> pixel_values(const ImageInfo& info,
                                                       std::span<const std::byte> bytes);

/// For a glance: 8 bits, colour where there is colour, at most `width_px` wide, as a JPEG file. Errors as
/// above.
[[nodiscard]] Result<std::vector<std::uint8_t>> small_jpeg(const ImageInfo& info,
                                                           std::span<const std::byte> bytes,
                                                           std::uint32_t width_px);
/// Grey or RGB pixels, row by row, as a PNG file. Empty: it cannot be written.
[[nodiscard]] std::vector<std::uint8_t> png_of(std::span<const std::uint8_t> pixels, int width_px,
                                               int height_px, int channels);
/// The same of 16-bit numbers.
[[nodiscard]] std::vector<std::uint8_t> png16_of(std::span<const std::uint16_t> values, int width_px,
                                                 int height_px);

}  // namespace rigor
