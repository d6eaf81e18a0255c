// From a frame as the device has it (rows with a stride, planes, JPEG) to a sample's pixels (rows without
// padding). Colour by sensor-hal/types/yuv.h, to nearest; chroma is that of the pair or square that a pixel
// is in.
#pragma once

#include <memory>

#include "drivers/v4l2/capture_device.h"

namespace rigor::v4l2 {

class JpegCodec;

enum class Converted : std::uint8_t {
  good,
  incomplete,  ///< the frame is shorter than its size says, or its JPEG is damaged; what is missing is zero
  refused      ///< nothing to be made of it
};

/// One thread; no allocation after the first frame.
class FrameConverter {
 public:
  /// `format.code` is one of codes_for(`to`).
  FrameConverter(const ActualFormat& format, PixelFormat to);
  ~FrameConverter();
  FrameConverter(FrameConverter&&) noexcept;
  FrameConverter& operator=(FrameConverter&&) noexcept;

  /// `out`: image_bytes(to, width, height).
  [[nodiscard]] Converted convert(std::span<const std::byte> frame, std::span<std::byte> out);

 private:
  ActualFormat format_;
  PixelFormat to_;
  std::unique_ptr<JpegCodec> jpeg_;
};

/// The other way, for devices that are emulated: the samples' format from which a frame of this code is made.
[[nodiscard]] std::optional<PixelFormat> made_from(std::uint32_t code) noexcept;
/// A frame's bytes without padding, at most (a JPEG is shorter).
[[nodiscard]] std::size_t frame_bytes(std::uint32_t code, std::uint32_t width_px,
                                      std::uint32_t height_px) noexcept;
/// Bytes of a row of the first plane; 0 for compressed formats.
[[nodiscard]] std::uint32_t frame_stride(std::uint32_t code, std::uint32_t width_px) noexcept;

/// One thread; no allocation after the first frame.
class FrameMaker {
 public:
  FrameMaker(std::uint32_t code, std::uint32_t width_px, std::uint32_t height_px, int jpeg_quality);
  ~FrameMaker();
  FrameMaker(FrameMaker&&) noexcept;
  FrameMaker& operator=(FrameMaker&&) noexcept;
  /// From a picture in made_from(code); `out` has frame_bytes. Bytes written; 0 where it failed.
  [[nodiscard]] std::size_t make(std::span<const std::byte> picture, std::span<std::byte> out);

 private:
  std::uint32_t code_, width_px_, height_px_;
  int quality_;
  std::unique_ptr<JpegCodec> jpeg_;
};

}  // namespace rigor::v4l2
