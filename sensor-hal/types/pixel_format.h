// Pixel formats of images, by the names of the PFNC (GenICam Pixel Format Naming Convention).
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string_view>

namespace rigor {

/// Those of 10, 12 and 16 bits lie in the low bits of a little-endian 16-bit word; mono12p is packed. YUV is
/// BT.601 of limited range (sensor-hal/types/yuv.h); its width is even, and that of 4:2:0 its height, too.
enum class PixelFormat : std::uint8_t {
  mono8,
  mono12p,
  mono16,
  bayer_rg8,
  rgb8,
  mono10,
  mono12,
  bayer_rg10,
  bayer_rg12,
  bayer_rg16,
  yuv422_8,    ///< Y U Y V: two pixels in four bytes
  yuv420_sp,   ///< a plane of Y, then one of U V pairs, one for 2x2 pixels: NV12
  coord3d_c16  ///< depth, in the device's unit (mostly mm); 0: none
};

/// What cameras of machine vision offer.
inline constexpr std::array kPixelFormats{
    PixelFormat::mono8,      PixelFormat::mono10,    PixelFormat::mono12,     PixelFormat::mono12p,
    PixelFormat::mono16,     PixelFormat::bayer_rg8, PixelFormat::bayer_rg10, PixelFormat::bayer_rg12,
    PixelFormat::bayer_rg16, PixelFormat::rgb8};
/// What video devices offer beside those.
inline constexpr std::array kVideoFormats{PixelFormat::yuv422_8, PixelFormat::yuv420_sp,
                                          PixelFormat::coord3d_c16};

[[nodiscard]] constexpr std::size_t bits_per_pixel(PixelFormat f) {
  switch (f) {
    case PixelFormat::mono8:
    case PixelFormat::bayer_rg8:
      return 8;
    case PixelFormat::mono12p:
    case PixelFormat::yuv420_sp:
      return 12;
    case PixelFormat::yuv422_8:
    case PixelFormat::coord3d_c16:
    case PixelFormat::mono10:
    case PixelFormat::mono12:
    case PixelFormat::mono16:
    case PixelFormat::bayer_rg10:
    case PixelFormat::bayer_rg12:
    case PixelFormat::bayer_rg16:
      return 16;
    case PixelFormat::rgb8:
      return 24;
  }
  return 0;
}
/// Bits of a sample that mean something: the largest value is 2^bits − 1.
[[nodiscard]] constexpr int significant_bits(PixelFormat f) {
  switch (f) {
    case PixelFormat::mono8:
    case PixelFormat::bayer_rg8:
    case PixelFormat::rgb8:
    case PixelFormat::yuv422_8:
    case PixelFormat::yuv420_sp:
      return 8;
    case PixelFormat::mono10:
    case PixelFormat::bayer_rg10:
      return 10;
    case PixelFormat::mono12:
    case PixelFormat::mono12p:
    case PixelFormat::bayer_rg12:
      return 12;
    case PixelFormat::mono16:
    case PixelFormat::bayer_rg16:
    case PixelFormat::coord3d_c16:
      return 16;
  }
  return 0;
}
[[nodiscard]] constexpr bool is_bayer(PixelFormat f) {
  return f == PixelFormat::bayer_rg8 || f == PixelFormat::bayer_rg10 || f == PixelFormat::bayer_rg12 ||
         f == PixelFormat::bayer_rg16;
}
[[nodiscard]] constexpr bool is_yuv(PixelFormat f) {
  return f == PixelFormat::yuv422_8 || f == PixelFormat::yuv420_sp;
}
/// Depth, not light: no camera gives it.
[[nodiscard]] constexpr bool is_depth(PixelFormat f) { return f == PixelFormat::coord3d_c16; }
[[nodiscard]] constexpr bool is_mono(PixelFormat f) {
  return !is_bayer(f) && !is_yuv(f) && !is_depth(f) && f != PixelFormat::rgb8;
}
/// One little-endian 16-bit word for each sample.
[[nodiscard]] constexpr bool has_words(PixelFormat f) { return bits_per_pixel(f) == 16 && !is_yuv(f); }
/// Bytes of a picture without padding; rows of mono12p follow each other without alignment, as PFNC packs
/// them.
[[nodiscard]] constexpr std::size_t image_bytes(PixelFormat f, std::size_t width_px, std::size_t height_px) {
  return (width_px * height_px * bits_per_pixel(f) + 7) / 8;
}
/// "Mono8", "BayerRG12", …
[[nodiscard]] constexpr std::string_view pfnc_name(PixelFormat f) {
  switch (f) {
    case PixelFormat::mono8:
      return "Mono8";
    case PixelFormat::mono10:
      return "Mono10";
    case PixelFormat::mono12:
      return "Mono12";
    case PixelFormat::mono12p:
      return "Mono12p";
    case PixelFormat::mono16:
      return "Mono16";
    case PixelFormat::bayer_rg8:
      return "BayerRG8";
    case PixelFormat::bayer_rg10:
      return "BayerRG10";
    case PixelFormat::bayer_rg12:
      return "BayerRG12";
    case PixelFormat::bayer_rg16:
      return "BayerRG16";
    case PixelFormat::rgb8:
      return "RGB8";
    case PixelFormat::yuv422_8:
      return "YUV422_8";
    case PixelFormat::yuv420_sp:
      return "YCbCr420_8_YY_CbCr_Semiplanar";
    case PixelFormat::coord3d_c16:
      return "Coord3D_C16";
  }
  return "?";
}
[[nodiscard]] constexpr std::optional<PixelFormat> pixel_format_from(std::string_view name) {
  for (PixelFormat f : kPixelFormats)
    if (pfnc_name(f) == name) return f;
  for (PixelFormat f : kVideoFormats)
    if (pfnc_name(f) == name) return f;
  return std::nullopt;
}

}  // namespace rigor
