#include "drivers/v4l2/uvc_control.h"

#include <gtest/gtest.h>
#include <linux/usb/video.h>

#include <cstring>

#include "drivers/v4l2/device_table.h"

namespace rigor::v4l2::uvc {
namespace {

constexpr std::uint8_t kIn = 0xA1, kOut = 0x21;  // class request to an interface

StreamOffer two_formats() {
  return {{{kYuyv, 640, 480, 614400}, {kMjpg, 640, 480, 307200}}, {333'333, 666'666}, 1024};
}
std::vector<std::uint8_t> wanted(std::uint8_t format, std::uint32_t interval) {
  const auto b = encode({.hint = 1, .format_index = format, .frame_index = 1, .interval = interval});
  return {b.begin(), b.end()};
}
StreamControl answer_of(const Answer& a) {
  EXPECT_EQ(a.kind, Answer::Kind::data);
  return decode({a.bytes.data(), a.length}).value();
}

// The kernel's own structure says where the fields are.
TEST(UvcControl, LaysOutTheProbeAsTheKernelDoes) {
  const auto b = encode({.hint = 0x0102,
                         .format_index = 3,
                         .frame_index = 4,
                         .interval = 333333,
                         .max_frame_bytes = 614400,
                         .max_payload_bytes = 3072});
  uvc_streaming_control k;
  static_assert(sizeof k == kControlBytes11);
  std::memcpy(&k, b.data(), sizeof k);
  // The struct is packed: + copies a field, which a reference could not be bound to.
  EXPECT_EQ(+k.bmHint, 0x0102);
  EXPECT_EQ(k.bFormatIndex, 3);
  EXPECT_EQ(k.bFrameIndex, 4);
  EXPECT_EQ(+k.dwFrameInterval, 333333u);
  EXPECT_EQ(+k.dwMaxVideoFrameSize, 614400u);
  EXPECT_EQ(+k.dwMaxPayloadTransferSize, 3072u);
  EXPECT_EQ(decode(b)->max_frame_bytes, 614400u);
  EXPECT_FALSE(decode(std::span(b).first(25)));
}

TEST(UvcControl, NegotiatesAsHostsDo) {
  ControlPipe pipe(two_formats());
  EXPECT_EQ(answer_of(pipe.setup({kIn, UVC_GET_DEF, UVC_VS_PROBE_CONTROL << 8, 1, 34})).interval, 333'333u);
  EXPECT_EQ(answer_of(pipe.setup({kIn, UVC_GET_MAX, UVC_VS_PROBE_CONTROL << 8, 1, 34})).interval, 666'666u);
  const Answer expect = pipe.setup({kOut, UVC_SET_CUR, UVC_VS_PROBE_CONTROL << 8, 1, 34});
  EXPECT_EQ(expect.kind, Answer::Kind::expect);
  EXPECT_EQ(expect.length, 34u);
  EXPECT_TRUE(pipe.data(wanted(2, 600'000)));  // the nearest interval
  const auto probed = answer_of(pipe.setup({kIn, UVC_GET_CUR, UVC_VS_PROBE_CONTROL << 8, 1, 26}));
  EXPECT_EQ(probed.format_index, 2);
  EXPECT_EQ(probed.interval, 666'666u);
  EXPECT_EQ(probed.max_frame_bytes, 307200u);
  EXPECT_EQ(pipe.committed().format_index, 1) << "probing does not commit";
  (void)pipe.setup({kOut, UVC_SET_CUR, UVC_VS_COMMIT_CONTROL << 8, 1, 34});
  EXPECT_TRUE(pipe.data(wanted(2, 333'333)));
  EXPECT_EQ(pipe.committed().format_index, 2);
  EXPECT_EQ(pipe.committed().interval, 333'333u);
}

TEST(UvcControl, TakesFormatsThatThereAreNot) {
  ControlPipe pipe(two_formats());
  for (const auto format : {std::uint8_t{0}, std::uint8_t{3}, std::uint8_t{255}}) {
    (void)pipe.setup({kOut, UVC_SET_CUR, UVC_VS_COMMIT_CONTROL << 8, 1, 26});
    EXPECT_TRUE(pipe.data(wanted(format, 1)));
    EXPECT_GE(pipe.committed().format_index, 1);
    EXPECT_LE(pipe.committed().format_index, 2);
  }
}

TEST(UvcControl, StallsWhatItDoesNotHaveAndSaysWhy) {
  ControlPipe pipe(two_formats());
  const auto error = [&] {
    const Answer a = pipe.setup({kIn, UVC_GET_CUR, UVC_VC_REQUEST_ERROR_CODE_CONTROL << 8, 0, 1});
    EXPECT_EQ(a.kind, Answer::Kind::data);
    return a.bytes[0];
  };
  EXPECT_EQ(error(), 0);
  EXPECT_EQ(pipe.setup({kIn, UVC_GET_CUR, 0x0900, 0x0200, 4}).kind, Answer::Kind::stall);  // a unit's control
  EXPECT_EQ(error(), 5);
  EXPECT_EQ(pipe.setup({kIn, 0x8F, UVC_VS_PROBE_CONTROL << 8, 1, 34}).kind, Answer::Kind::stall);
  EXPECT_EQ(error(), 7);
  EXPECT_EQ(pipe.setup({kOut, UVC_GET_CUR, UVC_VS_PROBE_CONTROL << 8, 1, 34}).kind, Answer::Kind::stall);
  EXPECT_EQ(pipe.setup({kOut, UVC_SET_CUR, UVC_VS_PROBE_CONTROL << 8, 1, 8}).kind, Answer::Kind::stall);
  EXPECT_EQ(error(), 4);
  EXPECT_FALSE(pipe.data(wanted(1, 1))) << "data that nobody asked for";
  EXPECT_EQ(error(), 1);
}

}  // namespace
}  // namespace rigor::v4l2::uvc
