#include "drivers/aravis/payload_size.h"

#include <fmt/format.h>

#include "sensor-hal/config/sample_size.h"

namespace rigor {

void check_payload(const PayloadClaim& claim, const AravisSettings& s, const ChannelConfig& config) {
  const auto refuse = [&](std::string message) {
    throw ConfigError({ErrorCode::protocol, config.name, std::move(message)});
  };
  if (claim.width_px == 0 || claim.height_px == 0 || claim.width_px > kMostPicturePixels / claim.height_px)
    refuse(fmt::format("expected a region of 1 … {} pixels, the camera says {}x{}", kMostPicturePixels,
                       claim.width_px, claim.height_px));
  const std::uint64_t pixels = claim.width_px * claim.height_px, said = claim.payload_bytes;
  const std::uint64_t picture = image_bytes(s.format, claim.width_px, claim.height_px);
  const auto region = [&] {
    return fmt::format("{}x{} {}", claim.width_px, claim.height_px, pfnc_name(s.format));
  };
  if (claim.multipart) {
    // How much of it is which part, the leaders of frames say.
    const std::uint64_t most = kMostParts * kMostPixelBytes * pixels + kMostExtraBytes;
    if (said < picture || said > most)
      refuse(fmt::format("expected {} … {} bytes for frames with a part of {}, the camera says {}", picture,
                         most, region(), said));
  } else if (s.chunks) {
    if (said < picture || said > picture + kMostExtraBytes)
      refuse(fmt::format("expected {} … {} bytes for each picture of {} with its chunks, the camera says {}",
                         picture, picture + kMostExtraBytes, region(), said));
  } else if (said != picture) {
    refuse(fmt::format(
        "expected {} bytes for each picture of {}, the camera says {}; padded rows are not supported: "
        "switch them off on the camera",
        picture, region(), said));
  }
  const std::uint64_t sample =
      s.parts() ? 2 * sizeof(float) * pixels : 0;  // beside the frame that it is made of
  check_buffer_memory(config.params, "buffers", s.buffers, said + sample);
}

}  // namespace rigor
