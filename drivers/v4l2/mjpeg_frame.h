// What a Motion-JPEG frame says of itself, read from its markers alone (ITU-T T.81, annex B): whether it is
// whole, and how large its picture is. Asked before a decoder is let near the bytes: a frame of another size
// than was negotiated never gets there.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

namespace rigor::v4l2 {

struct MjpegFrame {
  enum class Verdict : std::uint8_t {
    whole,      ///< start and end of image, a frame header, a scan
    truncated,  ///< well formed as far as it goes, without an end of image
    broken      ///< no JPEG
  } verdict = Verdict::broken;
  std::uint32_t width_px = 0, height_px = 0;
  std::uint8_t components = 0, bits = 0;
  bool progressive = false;
  std::size_t scans = 0;
  bool own_huffman_tables = false;  ///< else those of annex K.3, as UVC cameras leave them out
  std::size_t size_bytes = 0;       ///< to the end of image; drivers pad behind it
};

/// Any bytes. Any thread, no allocation.
[[nodiscard]] MjpegFrame read_mjpeg(std::span<const std::byte> bytes) noexcept;

}  // namespace rigor::v4l2
