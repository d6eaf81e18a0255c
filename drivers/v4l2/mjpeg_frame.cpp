#include "drivers/v4l2/mjpeg_frame.h"

#include "rt-core/byte_order.h"

namespace rigor::v4l2 {

MjpegFrame read_mjpeg(std::span<const std::byte> bytes) noexcept {
  MjpegFrame f;
  const auto at = [&](std::size_t i) { return std::to_integer<std::uint8_t>(bytes[i]); };
  if (bytes.size() < 4 || at(0) != 0xFF || at(1) != 0xD8) return f;
  std::size_t i = 2;
  bool scan = false;
  // Segments between markers; from SOS on entropy-coded bytes, in which FF 00 is a byte and FF D0…D7 a
  // restart.
  while (i + 1 < bytes.size()) {
    if (at(i) != 0xFF) {
      if (!scan) return f;  // bytes that belong to no segment
      ++i;
      continue;
    }
    const std::uint8_t marker = at(i + 1);
    if (marker == 0xFF) {  // fill
      ++i;
      continue;
    }
    if (marker == 0x00 || (marker >= 0xD0 && marker <= 0xD7) || marker == 0x01) {
      if (marker != 0x01 && !scan) return f;
      i += 2;
      continue;
    }
    if (marker == 0xD9) {
      f.size_bytes = i + 2;
      if (scan && f.width_px != 0) f.verdict = MjpegFrame::Verdict::whole;
      return f;
    }
    if (marker == 0xD8) return f;
    if (i + 4 > bytes.size()) break;
    const std::size_t length = load_be<std::uint16_t>(bytes, i + 2);
    if (length < 2) return f;
    const std::size_t body = i + 4, end = i + 2 + length;
    if (end > bytes.size()) break;
    const bool frame_header =
        marker >= 0xC0 && marker <= 0xCF && marker != 0xC4 && marker != 0xC8 && marker != 0xCC;
    if (frame_header) {
      if (length < 8 || f.width_px != 0) return f;
      f.bits = at(body);
      f.height_px = load_be<std::uint16_t>(bytes, body + 1),
      f.width_px = load_be<std::uint16_t>(bytes, body + 3);
      f.components = at(body + 5);
      f.progressive = marker != 0xC0 && marker != 0xC1;
      if (f.width_px == 0 || f.height_px == 0 || f.components == 0) return f;
    }
    if (marker == 0xC4) f.own_huffman_tables = true;
    if (marker == 0xDA) {
      if (f.width_px == 0) return f;
      scan = true;
      ++f.scans;
    }
    i = end;
  }
  f.size_bytes = bytes.size();
  if (scan) f.verdict = MjpegFrame::Verdict::truncated;
  return f;
}

}  // namespace rigor::v4l2
