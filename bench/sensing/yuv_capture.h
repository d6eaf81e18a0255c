// YUV from cameras that measure light: the picture in RGB8, then converted as a video device would.
#pragma once

#include <vector>

#include "sensor-hal/channel/providers.h"
#include "sensor-hal/types/yuv.h"

namespace rigor {

/// The format in which a camera's picture is made when this one is asked for.
[[nodiscard]] constexpr PixelFormat light_format(PixelFormat asked) {
  return is_yuv(asked) ? PixelFormat::rgb8 : asked;
}

/// Calls `capture(request, pixels)` in a format that cameras make, and converts where YUV was asked for.
/// `request` names a region, or `sensor` says how large the whole is. bad_input for depth and odd sizes.
template <class Capture>
[[nodiscard]] Status capture_converted(const ImageRequest& request, const ImageProvider::Geometry& sensor,
                                       std::span<std::byte> pixels, std::vector<std::byte>& scratch,
                                       Capture&& capture) {
  if (is_depth(request.format))
    return fail(ErrorCode::bad_input, "pixel_format", "a camera measures light, not depth");
  if (!is_yuv(request.format)) return capture(request, pixels);
  ImageRequest in_rgb = request;
  in_rgb.format = PixelFormat::rgb8;
  const std::size_t width = request.width_px != 0 ? request.width_px : sensor.width_px;
  const std::size_t height = request.width_px != 0 ? request.height_px : sensor.height_px;
  const bool planes = request.format == PixelFormat::yuv420_sp;
  if (width % 2 != 0 || (planes && height % 2 != 0) ||
      pixels.size() < image_bytes(request.format, width, height))
    return fail(ErrorCode::bad_input, "pixel_format",
                std::string(pfnc_name(request.format)) + ": expected an even size in pixels");
  scratch.resize(image_bytes(PixelFormat::rgb8, width, height));
  if (auto s = capture(in_rgb, std::span(scratch)); !s) return s;
  if (planes)
    yuv::yuv420_from_rgb8(scratch, width, height, pixels);
  else
    yuv::yuv422_from_rgb8(scratch, pixels);
  return {};
}

}  // namespace rigor
