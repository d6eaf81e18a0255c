// Pixel formats of images, by the names of the PFNC (GenICam Pixel Format Naming Convention).
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string_view>

namespace rigor {

enum class PixelFormat : std::uint8_t { mono8, mono12p, mono16, bayer_rg8, rgb8 };

[[nodiscard]] constexpr std::size_t bits_per_pixel(PixelFormat f) {
  switch (f) {
    case PixelFormat::mono8:
    case PixelFormat::bayer_rg8:
      return 8;
    case PixelFormat::mono12p:
      return 12;
    case PixelFormat::mono16:
      return 16;
    case PixelFormat::rgb8:
      return 24;
  }
  return 0;
}
/// Bytes of a picture without padding; rows of mono12p follow each other without alignment, as PFNC packs
/// them.
[[nodiscard]] constexpr std::size_t image_bytes(PixelFormat f, std::size_t width_px, std::size_t height_px) {
  return (width_px * height_px * bits_per_pixel(f) + 7) / 8;
}
/// "Mono8", "Mono12p", "Mono16", "BayerRG8", "RGB8".
[[nodiscard]] constexpr std::string_view pfnc_name(PixelFormat f) {
  switch (f) {
    case PixelFormat::mono8:
      return "Mono8";
    case PixelFormat::mono12p:
      return "Mono12p";
    case PixelFormat::mono16:
      return "Mono16";
    case PixelFormat::bayer_rg8:
      return "BayerRG8";
    case PixelFormat::rgb8:
      return "RGB8";
  }
  return "?";
}
[[nodiscard]] constexpr std::optional<PixelFormat> pixel_format_from(std::string_view name) {
  for (PixelFormat f : {PixelFormat::mono8, PixelFormat::mono12p, PixelFormat::mono16, PixelFormat::bayer_rg8,
                        PixelFormat::rgb8})
    if (pfnc_name(f) == name) return f;
  return std::nullopt;
}

}  // namespace rigor
