// Frames of a camera: Motion-JPEG through the reader of markers and, where it was built with libjpeg, the
// decoder; and raw frames of any length through each conversion. Input: `way:8 bytes`.
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <vector>

#include "drivers/v4l2/frame_conversion.h"
#include "drivers/v4l2/mjpeg_frame.h"

using namespace rigor;
using namespace rigor::v4l2;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size < 1) return 0;
  struct Way {
    std::uint32_t code;
    PixelFormat to;
    std::uint32_t stride;
  };
  static constexpr Way kWays[] = {{kMjpg, PixelFormat::rgb8, 0},       {kMjpg, PixelFormat::mono8, 0},
                                  {kYuyv, PixelFormat::rgb8, 0},       {kUyvy, PixelFormat::mono8, 40},
                                  {kNv12, PixelFormat::rgb8, 17},      {kNv12, PixelFormat::yuv420_sp, 20},
                                  {kYu12, PixelFormat::yuv420_sp, 18}, {kYu12, PixelFormat::rgb8, 0},
                                  {kGrey, PixelFormat::mono8, 19},     {kY16Be, PixelFormat::mono16, 0},
                                  {kBgr3, PixelFormat::rgb8, 50},      {kZ16, PixelFormat::coord3d_c16, 0}};
  const Way& way = kWays[data[0] % std::size(kWays)];
  const std::span frame(reinterpret_cast<const std::byte*>(data + 1), size - 1);
  const MjpegFrame head = read_mjpeg(frame);
  if (head.size_bytes > frame.size()) std::abort();
  constexpr std::uint32_t kW = 16, kH = 8;
#ifndef RIGOR_V4L2_WITH_JPEG
  if (way.code == kMjpg) return 0;
#endif
  FrameConverter converter({.code = way.code, .width_px = kW, .height_px = kH, .stride_bytes = way.stride},
                           way.to);
  std::vector<std::byte> out(image_bytes(way.to, kW, kH));
  if (converter.convert(frame, out) == Converted::good && way.code == kMjpg &&
      head.verdict != MjpegFrame::Verdict::whole)
    std::abort();
  return 0;
}
