#include "drivers/v4l2/jpeg_codec.h"

#include <cstdio>
// libjpeg's header wants <cstdio> before it.
#include <jpeglib.h>

#include <algorithm>
#include <csetjmp>
#include <cstdlib>
#include <cstring>

#include "drivers/v4l2/mjpeg_frame.h"

namespace rigor::v4l2 {
namespace {

/// libjpeg leaves a call that fails by this; nothing with a destructor lives between setjmp and there.
struct Errors {
  jpeg_error_mgr base{};
  std::jmp_buf leave{};
};
[[noreturn]] void leave(j_common_ptr c) { std::longjmp(reinterpret_cast<Errors*>(c->err)->leave, 1); }
void be_silent(j_common_ptr) {}
void count_warnings(j_common_ptr c, int level) {
  if (level < 0) ++c->err->num_warnings;
}

void prepare(Errors& e) {
  jpeg_std_error(&e.base);
  e.base.error_exit = leave;
  e.base.output_message = be_silent;
  e.base.emit_message = count_warnings;
}

}  // namespace

struct JpegCodec::Impl {
  Errors decode_errors, encode_errors;
  jpeg_decompress_struct in{};
  jpeg_compress_struct out{};
  unsigned char* memory = nullptr;  // grown by libjpeg, with malloc
  unsigned long memory_bytes = 0;
};

JpegCodec::JpegCodec() : impl_(std::make_unique<Impl>()) {
  prepare(impl_->decode_errors);
  prepare(impl_->encode_errors);
  impl_->in.err = &impl_->decode_errors.base;
  impl_->out.err = &impl_->encode_errors.base;
  jpeg_create_decompress(&impl_->in);
  jpeg_create_compress(&impl_->out);
}

JpegCodec::~JpegCodec() {
  jpeg_destroy_decompress(&impl_->in);
  jpeg_destroy_compress(&impl_->out);
  std::free(impl_->memory);
}

JpegCodec::Decoded JpegCodec::decode(std::span<const std::byte> frame, PixelFormat format,
                                     std::uint32_t width_px, std::uint32_t height_px,
                                     std::span<std::byte> out) noexcept {
  std::memset(out.data(), 0, out.size());
  const MjpegFrame head = read_mjpeg(frame);
  const bool colour = format == PixelFormat::rgb8;
  if (head.verdict == MjpegFrame::Verdict::broken || head.progressive || head.bits != 8 ||
      head.width_px != width_px || head.height_px != height_px || (!colour && format != PixelFormat::mono8) ||
      (head.components != 1 && head.components != 3) ||
      // A baseline frame has at most one for each component. libjpeg decodes all that there are before the
      // first row.
      head.scans > head.components || out.size() < image_bytes(format, width_px, height_px))
    return Decoded::refused;
  jpeg_decompress_struct& c = impl_->in;
  impl_->decode_errors.base.num_warnings = 0;
  volatile bool some = false;
  if (setjmp(impl_->decode_errors.leave) != 0) {
    jpeg_abort_decompress(&c);
    return some ? Decoded::damaged : Decoded::refused;
  }
  jpeg_mem_src(&c, reinterpret_cast<const unsigned char*>(frame.data()),
               static_cast<unsigned long>(head.size_bytes));
  if (jpeg_read_header(&c, TRUE) != JPEG_HEADER_OK || c.image_width != width_px ||
      c.image_height != height_px) {
    jpeg_abort_decompress(&c);
    return Decoded::refused;
  }
  c.out_color_space = colour ? JCS_RGB : JCS_GRAYSCALE;
  c.dct_method = JDCT_ISLOW;
  jpeg_start_decompress(&c);
  const std::size_t row_bytes = std::size_t{width_px} * (colour ? 3 : 1);
  while (c.output_scanline < c.output_height) {
    auto* row = reinterpret_cast<JSAMPROW>(out.data() + c.output_scanline * row_bytes);
    if (jpeg_read_scanlines(&c, &row, 1) != 1) break;
    some = true;
  }
  const bool whole = c.output_scanline == c.output_height;
  if (whole)
    jpeg_finish_decompress(&c);
  else
    jpeg_abort_decompress(&c);
  return whole && head.verdict == MjpegFrame::Verdict::whole && impl_->decode_errors.base.num_warnings == 0
             ? Decoded::good
             : Decoded::damaged;
}

std::span<const std::byte> JpegCodec::encode(std::span<const std::byte> pixels, PixelFormat format,
                                             std::uint32_t width_px, std::uint32_t height_px,
                                             int quality) noexcept {
  const bool colour = format == PixelFormat::rgb8;
  if ((!colour && format != PixelFormat::mono8) || width_px == 0 || width_px > JPEG_MAX_DIMENSION ||
      height_px == 0 || height_px > JPEG_MAX_DIMENSION ||
      pixels.size() < image_bytes(format, width_px, height_px))
    return {};
  jpeg_compress_struct& c = impl_->out;
  if (setjmp(impl_->encode_errors.leave) != 0) {
    jpeg_abort_compress(&c);
    return {};
  }
  // libjpeg writes into memory that is large enough, and makes larger memory, which is then ours, where not.
  unsigned char* before = impl_->memory;
  unsigned long bytes = impl_->memory_bytes;
  jpeg_mem_dest(&c, &impl_->memory, &bytes);
  c.image_width = width_px, c.image_height = height_px;
  c.input_components = colour ? 3 : 1;
  c.in_color_space = colour ? JCS_RGB : JCS_GRAYSCALE;
  jpeg_set_defaults(&c);
  jpeg_set_quality(&c, std::clamp(quality, 1, 100), TRUE);
  if (colour) {
    jpeg_set_colorspace(&c, JCS_YCbCr);
    c.comp_info[0].h_samp_factor = 2, c.comp_info[0].v_samp_factor = 1;
  }
  jpeg_start_compress(&c, TRUE);
  const std::size_t row_bytes = std::size_t{width_px} * (colour ? 3 : 1);
  while (c.next_scanline < c.image_height) {
    auto* row =
        reinterpret_cast<JSAMPROW>(const_cast<std::byte*>(pixels.data() + c.next_scanline * row_bytes));
    jpeg_write_scanlines(&c, &row, 1);
  }
  jpeg_finish_compress(&c);
  if (impl_->memory != before) {
    std::free(before);
    impl_->memory_bytes = bytes;
  } else {
    impl_->memory_bytes = std::max(impl_->memory_bytes, bytes);
  }
  return {reinterpret_cast<const std::byte*>(impl_->memory), bytes};
}

}  // namespace rigor::v4l2
