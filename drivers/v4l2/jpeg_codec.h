// JPEG by libjpeg (libjpeg-turbo): the frames of Motion-JPEG cameras into pixels, and pixels into the frames
// of an emulated one. Frames without Huffman tables, as UVC cameras send them, are decoded with those of T.81
// annex K.3, which libjpeg-turbo supplies. Built only where libjpeg is there.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>

#include "sensor-hal/types/pixel_format.h"

namespace rigor::v4l2 {

/// One thread; memory is kept between frames.
class JpegCodec {
 public:
  JpegCodec();
  ~JpegCodec();
  JpegCodec(const JpegCodec&) = delete;
  JpegCodec& operator=(const JpegCodec&) = delete;

  enum class Decoded : std::uint8_t {
    good,
    damaged,  ///< pixels are there, not all of them right; what never came is zero
    refused   ///< no picture of this size, or none at all; `out` is zero
  };
  /// `out`: mono8 or rgb8 of width x height. Progressive frames and frames of more scans than components
  /// are refused before they are decoded: cameras send none, and they may cost without bound.
  [[nodiscard]] Decoded decode(std::span<const std::byte> frame, PixelFormat format, std::uint32_t width_px,
                               std::uint32_t height_px, std::span<std::byte> out) noexcept;
  /// From mono8 or rgb8; 4:2:2 as UVC cameras do. Valid until the next call; empty where it failed.
  [[nodiscard]] std::span<const std::byte> encode(std::span<const std::byte> pixels, PixelFormat format,
                                                  std::uint32_t width_px, std::uint32_t height_px,
                                                  int quality) noexcept;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace rigor::v4l2
