// How large a frame a camera says it sends, checked before memory is taken for it: a camera, or whoever
// answers in its place, may say any 32-bit number, and each buffer has that size.
#pragma once

#include <cstddef>
#include <cstdint>

#include "drivers/aravis/aravis_settings.h"

namespace rigor {

/// Beyond the pictures: chunks, and what stands around parts.
inline constexpr std::size_t kMostExtraBytes = std::size_t{1} << 20;
/// GenDC and GigE Vision 2.1 allow more; cameras send range, intensity, confidence and their like.
inline constexpr std::size_t kMostParts = 16;
/// Of a part: four floats for each pixel.
inline constexpr std::size_t kMostPixelBytes = 16;

/// What a camera says of its frames.
struct PayloadClaim {
  std::uint64_t width_px = 0, height_px = 0, payload_bytes = 0;
  bool multipart = false;
};

/// Throws ConfigError, `protocol` at the channel's name: a picture of no size or of more than
/// kMostPicturePixels, a payload that is less than the picture, or more than chunks or parts explain, or
/// other than the picture where there is neither; bad_input at `buffers` where that many do not fit in this
/// machine's memory. Setup context.
void check_payload(const PayloadClaim& claim, const AravisSettings& settings, const ChannelConfig& config);

}  // namespace rigor
