#include "drivers/v4l2/frame_conversion.h"

#include <algorithm>
#include <cstring>

#include "drivers/v4l2/jpeg_codec.h"
#include "sensor-hal/types/yuv.h"

namespace rigor::v4l2 {
#ifndef RIGOR_V4L2_WITH_JPEG
class JpegCodec {};
#endif
namespace {

using Bytes = std::span<const std::byte>;
using U8 = const std::uint8_t*;

constexpr bool is_jpeg(std::uint32_t code) { return code == kMjpg || code == kJpeg; }

/// Rows of a frame that are there as a whole: row(i) is null for one that is not.
struct Plane {
  Bytes bytes;
  std::size_t stride = 0, row_bytes = 0;
  [[nodiscard]] U8 row(std::size_t i) const {
    const std::size_t first = i * stride;
    return first + row_bytes <= bytes.size() ? reinterpret_cast<U8>(bytes.data() + first) : nullptr;
  }
};

std::uint8_t grey(std::uint8_t y) { return yuv::rgb(y, 128, 128)[0]; }

void put(std::uint8_t* out, const std::array<std::uint8_t, 3>& rgb) {
  out[0] = rgb[0], out[1] = rgb[1], out[2] = rgb[2];
}

/// One row of packed or planar pixels; `uv` and `v` are the chroma rows where there are any.
using RowFunction = void (*)(U8 row, U8 u, U8 v, std::uint8_t* out, std::size_t width);

void swap_words(U8 p, U8, U8, std::uint8_t* q, std::size_t width) {
  for (std::size_t i = 0; i < width; ++i) q[2 * i] = p[2 * i + 1], q[2 * i + 1] = p[2 * i];
}
void swap_pairs(U8 p, U8, U8, std::uint8_t* q, std::size_t width) { swap_words(p, {}, {}, q, width); }
void bgr_to_rgb(U8 p, U8, U8, std::uint8_t* q, std::size_t width) {
  for (std::size_t i = 0; i < width; ++i, p += 3, q += 3) q[0] = p[2], q[1] = p[1], q[2] = p[0];
}
void luma_to_grey(U8 p, U8, U8, std::uint8_t* q, std::size_t width) {
  for (std::size_t i = 0; i < width; ++i) q[i] = grey(p[i]);
}
template <int Luma>
void packed_to_grey(U8 p, U8, U8, std::uint8_t* q, std::size_t width) {
  for (std::size_t i = 0; i < width; ++i) q[i] = grey(p[2 * i + Luma]);
}
template <int Luma>
void packed_to_rgb(U8 p, U8, U8, std::uint8_t* q, std::size_t width) {
  constexpr int kChroma = 1 - Luma;
  for (std::size_t i = 0; i + 1 < width; i += 2, p += 4, q += 6) {
    put(q, yuv::rgb(p[Luma], p[kChroma], p[kChroma + 2]));
    put(q + 3, yuv::rgb(p[Luma + 2], p[kChroma], p[kChroma + 2]));
  }
  // The row of an odd width ends within a pair: its V is that of the pair before.
  if (width % 2 != 0) put(q, yuv::rgb(p[Luma], p[kChroma], width > 1 ? p[kChroma - 2] : 128));
}
template <int Step>
void planar_to_rgb(U8 p, U8 u, U8 v, std::uint8_t* q, std::size_t width) {
  for (std::size_t i = 0; i < width; ++i, q += 3) put(q, yuv::rgb(p[i], u[i / 2 * Step], v[i / 2 * Step]));
}

RowFunction row_function(std::uint32_t code, PixelFormat to) {
  if (code == kY16Be) return swap_words;
  if (code == kUyvy && to == PixelFormat::yuv422_8) return swap_pairs;
  if (code == kBgr3) return bgr_to_rgb;
  const bool planar = code == kNv12 || code == kYu12;
  if (to == PixelFormat::mono8)
    return planar          ? luma_to_grey
           : code == kYuyv ? packed_to_grey<0>
           : code == kUyvy ? packed_to_grey<1>
                           : nullptr;
  if (to == PixelFormat::rgb8)
    return code == kNv12   ? planar_to_rgb<2>
           : code == kYu12 ? planar_to_rgb<1>
           : code == kYuyv ? packed_to_rgb<0>
           : code == kUyvy ? packed_to_rgb<1>
                           : nullptr;
  return nullptr;
}

}  // namespace

std::optional<PixelFormat> made_from(std::uint32_t code) noexcept {
  if (code == kBgr3) return PixelFormat::rgb8;
  if (code == kUyvy) return PixelFormat::yuv422_8;
#ifdef RIGOR_V4L2_WITH_JPEG
  if (is_jpeg(code)) return PixelFormat::rgb8;
#endif
  const auto same = same_bytes(code);
  return same;
}

std::uint32_t frame_stride(std::uint32_t code, std::uint32_t width_px) noexcept {
  if (is_jpeg(code)) return 0;
  if (code == kNv12 || code == kYu12 || code == kGrey || code == kRggb) return width_px;
  return code == kRgb3 || code == kBgr3 ? 3 * width_px : 2 * width_px;
}

std::size_t frame_bytes(std::uint32_t code, std::uint32_t width_px, std::uint32_t height_px) noexcept {
  // A JPEG of noise at full quality can be larger than its pixels, by tables and stuffed bytes.
  if (is_jpeg(code)) return std::size_t{width_px} * height_px * 4 + 4096;
  const std::size_t first = std::size_t{frame_stride(code, width_px)} * height_px;
  return code == kNv12 || code == kYu12 ? first + first / 2 : first;
}

FrameConverter::FrameConverter(const ActualFormat& format, PixelFormat to) : format_(format), to_(to) {
#ifdef RIGOR_V4L2_WITH_JPEG
  if (is_jpeg(format.code)) jpeg_ = std::make_unique<JpegCodec>();
#endif
}
FrameConverter::~FrameConverter() = default;
FrameConverter::FrameConverter(FrameConverter&&) noexcept = default;
FrameConverter& FrameConverter::operator=(FrameConverter&&) noexcept = default;

Converted FrameConverter::convert(Bytes frame, std::span<std::byte> out) {
  const std::size_t width = format_.width_px, height = format_.height_px;
  if (out.size() < image_bytes(to_, width, height)) return Converted::refused;
#ifdef RIGOR_V4L2_WITH_JPEG
  if (jpeg_) {
    const auto decoded = jpeg_->decode(frame, to_, format_.width_px, format_.height_px, out);
    return decoded == JpegCodec::Decoded::good      ? Converted::good
           : decoded == JpegCodec::Decoded::damaged ? Converted::incomplete
                                                    : Converted::refused;
  }
#endif
  if (frame.empty()) return Converted::refused;
  auto* q = reinterpret_cast<std::uint8_t*>(out.data());
  const std::size_t row_bytes = frame_stride(format_.code, format_.width_px);
  const std::size_t stride = std::max<std::size_t>(format_.stride_bytes, row_bytes);
  const Plane first{frame, stride, row_bytes};
  const Bytes rest = frame.size() > stride * height ? frame.subspan(stride * height) : Bytes{};
  const bool semiplanar = format_.code == kNv12, planar = format_.code == kYu12;
  // V4L2: chroma rows of NV12 are as long as luma's, those of YU12 half of that; of odd sizes the larger
  // half.
  const std::size_t chroma_width = (width + 1) / 2, chroma_height = (height + 1) / 2;
  const std::size_t half_stride = (stride + 1) / 2, plane = half_stride * chroma_height;
  const Plane u{rest, planar ? half_stride : stride, planar ? chroma_width : 2 * chroma_width};
  const Plane v{planar && rest.size() > plane ? rest.subspan(plane) : Bytes{}, half_stride, chroma_width};
  const RowFunction by_row = row_function(format_.code, to_);
  const std::size_t out_row = to_ == PixelFormat::yuv420_sp ? width : image_bytes(to_, width, 1);
  const bool chroma_used = to_ == PixelFormat::rgb8 && (semiplanar || planar);
  bool missing = false;
  for (std::size_t i = 0; i < height; ++i) {
    const U8 row = first.row(i);
    const U8 row_u = chroma_used ? u.row(i / 2) : nullptr;
    const U8 row_v = !chroma_used ? nullptr : semiplanar ? (row_u ? row_u + 1 : nullptr) : v.row(i / 2);
    if (!row || (chroma_used && (!row_u || !row_v))) {
      std::memset(q + i * out_row, 0, out_row);
      missing = true;
    } else if (by_row) {
      by_row(row, row_u, row_v, q + i * out_row, width);
    } else {
      std::memcpy(q + i * out_row, row, out_row);
    }
  }
  if (to_ == PixelFormat::yuv420_sp) {
    std::uint8_t* chroma = q + width * height;
    for (std::size_t i = 0; i < height / 2; ++i, chroma += width) {
      const U8 row_u = u.row(i), row_v = semiplanar ? row_u : v.row(i);
      if (!row_u || !row_v) {
        std::memset(chroma, 0, width);
        missing = true;
      } else if (semiplanar) {
        std::memcpy(chroma, row_u, width);
      } else {
        for (std::size_t k = 0; k < width / 2; ++k) chroma[2 * k] = row_u[k], chroma[2 * k + 1] = row_v[k];
      }
    }
  }
  return missing ? Converted::incomplete : Converted::good;
}

FrameMaker::FrameMaker(std::uint32_t code, std::uint32_t width_px, std::uint32_t height_px, int jpeg_quality)
    : code_(code), width_px_(width_px), height_px_(height_px), quality_(jpeg_quality) {
#ifdef RIGOR_V4L2_WITH_JPEG
  if (is_jpeg(code)) jpeg_ = std::make_unique<JpegCodec>();
#endif
}
FrameMaker::~FrameMaker() = default;
FrameMaker::FrameMaker(FrameMaker&&) noexcept = default;
FrameMaker& FrameMaker::operator=(FrameMaker&&) noexcept = default;

std::size_t FrameMaker::make(Bytes picture, std::span<std::byte> out) {
#ifdef RIGOR_V4L2_WITH_JPEG
  if (jpeg_) {
    const auto frame = jpeg_->encode(picture, PixelFormat::rgb8, width_px_, height_px_, quality_);
    if (frame.empty() || frame.size() > out.size()) return 0;
    std::memcpy(out.data(), frame.data(), frame.size());
    return frame.size();
  }
#endif
  const std::size_t size = frame_bytes(code_, width_px_, height_px_);
  if (picture.size() < size || out.size() < size) return 0;
  const auto* p = reinterpret_cast<U8>(picture.data());
  auto* q = reinterpret_cast<std::uint8_t*>(out.data());
  if (code_ == kBgr3)
    bgr_to_rgb(p, {}, {}, q, size / 3);
  else if (code_ == kUyvy)
    swap_pairs(p, {}, {}, q, size / 2);
  else
    std::memcpy(q, p, size);
  return size;
}

}  // namespace rigor::v4l2
