#include "drivers/v4l2/negotiation.h"

#include "drivers/v4l2/control_values.h"
#include "tests/drivers/v4l2/v4l2_test_tools.h"

namespace rigor::v4l2 {
namespace {

using testing::HasSubstr;

FormatRequest ask(PixelFormat format, std::uint32_t w, std::uint32_t h, double rate_hz,
                  std::uint32_t code = 0) {
  return {format, code, w, h, seconds_from(1 / rate_hz)};
}

TEST(FourCcNames, LeadThereAndBack) {
  for (const std::uint32_t code : {kGrey, kY10, kY16, kY16Be, kZ16, kYuyv, kNv12, kMjpg, kRggb})
    EXPECT_EQ(fourcc_from(fourcc_text(code)), code) << fourcc_text(code);
  EXPECT_EQ(fourcc_text(kY10), "Y10");
  EXPECT_EQ(fourcc_text(kY16Be), "Y16-BE");
  EXPECT_FALSE(fourcc_from(""));
  EXPECT_FALSE(fourcc_from("YUYV2"));
  EXPECT_FALSE(fourcc_from("\x01xx"));
}

TEST(FormatNegotiation, TakesTheSameBytesBeforeDecoding) {
  const auto c = negotiate(test::webcam(), ask(PixelFormat::yuv422_8, 640, 480, 30));
  ASSERT_TRUE(c) << c.error().text();
  EXPECT_EQ(c->code, kYuyv);
  EXPECT_EQ(c->interval, (Interval{1, 30}));
}

#ifdef RIGOR_V4L2_WITH_JPEG
TEST(FormatNegotiation, DecodesJpegWhereOnlyThatIsFastEnough) {
  const auto slow = negotiate(test::webcam(), ask(PixelFormat::rgb8, 1280, 720, 10));
  ASSERT_TRUE(slow);
  EXPECT_EQ(slow->code, kYuyv);
  const auto fast = negotiate(test::webcam(), ask(PixelFormat::rgb8, 1280, 720, 30));
  ASSERT_TRUE(fast) << fast.error().text();
  EXPECT_EQ(fast->code, kMjpg);
}
#endif

TEST(FormatNegotiation, TakesTheDevicesOwnSizeAndRateWhereNoneIsAsked) {
  const auto c = negotiate(test::webcam(), {PixelFormat::yuv422_8, 0, 0, 0, {}});
  ASSERT_TRUE(c);
  EXPECT_EQ(c->width_px, 640u);
  EXPECT_EQ(c->interval.numerator, 0u);
}

TEST(FormatNegotiation, SaysWhichFormatsThereAre) {
  const auto c = negotiate(test::webcam(), ask(PixelFormat::coord3d_c16, 640, 480, 30));
  ASSERT_FALSE(c);
  EXPECT_EQ(c.error().where, "pixel_format");
  EXPECT_THAT(c.error().message, HasSubstr("Coord3D_C16 is made of Z16"));
  EXPECT_THAT(c.error().message, HasSubstr("it offers YUYV, MJPG"));
}

TEST(FormatNegotiation, SaysWhichSizesThereAreAndTheNearest) {
  const auto c = negotiate(test::webcam(), ask(PixelFormat::yuv422_8, 642, 480, 30));
  ASSERT_FALSE(c);
  EXPECT_EQ(c.error().where, "width_px");
  EXPECT_THAT(c.error().message, HasSubstr("640x480, 320x240, 1280x720"));
  EXPECT_THAT(c.error().message, HasSubstr("nearest is 640x480"));
}

TEST(FormatNegotiation, SaysWhichRatesThereAre) {
  const auto c = negotiate(test::webcam(), ask(PixelFormat::yuv422_8, 1280, 720, 30));
  ASSERT_FALSE(c);
  EXPECT_EQ(c.error().where, "rate_hz");
  EXPECT_THAT(c.error().message, HasSubstr("10, 7.5, 5 Hz; got 30 Hz"));
}

TEST(FormatNegotiation, Tells29And97HzFrom30) {
  DeviceTable t = test::webcam();
  t.formats[0].sizes[0].intervals = {{1001, 30000}, {333333, 10000000}};
  const auto c = negotiate(t, ask(PixelFormat::yuv422_8, 640, 480, 30));
  ASSERT_TRUE(c);
  EXPECT_EQ(c->interval, (Interval{333333, 10000000}));
  const auto ntsc = negotiate(t, ask(PixelFormat::yuv422_8, 640, 480, 30000.0 / 1001));
  ASSERT_TRUE(ntsc);
  EXPECT_EQ(ntsc->interval, (Interval{1001, 30000}));
}

TEST(FormatNegotiation, KeepsToStepsOfSizes) {
  DeviceTable t = test::webcam();
  OfferedSize s;
  s.min_width_px = 32, s.max_width_px = 1920, s.step_width_px = 16;
  s.min_height_px = 32, s.max_height_px = 1080, s.step_height_px = 2;
  s.intervals = {{1, 60}, {1, 1}};
  s.continuous = true;
  t.formats = {{kGrey, "8-bit Greyscale", {s}}};
  EXPECT_TRUE(negotiate(t, ask(PixelFormat::mono8, 48, 34, 25)));
  EXPECT_FALSE(negotiate(t, ask(PixelFormat::mono8, 40, 34, 25)));
  EXPECT_FALSE(negotiate(t, ask(PixelFormat::mono8, 48, 33, 25)));
  EXPECT_FALSE(negotiate(t, ask(PixelFormat::mono8, 48, 34, 70)));
}

TEST(FormatNegotiation, RefusesADeviceFormatThatCannotGiveTheSamples) {
  const auto c = negotiate(test::webcam(), ask(PixelFormat::yuv422_8, 640, 480, 30, kMjpg));
  ASSERT_FALSE(c);
  EXPECT_EQ(c.error().where, "device_format");
  const auto none = negotiate(test::webcam(), ask(PixelFormat::mono8, 640, 480, 30, kGrey));
  ASSERT_FALSE(none);
  EXPECT_THAT(none.error().message, HasSubstr("offers: YUYV, MJPG; got GREY"));
}

Result<std::vector<ControlValue>> checked(const std::string& yaml) {
  auto n = ConfigDocument::parse(yaml, "rig.yaml");
  EXPECT_TRUE(n);
  return catch_config([&] { return check_controls(*n, test::webcam()); });
}

TEST(Controls, TakeNumbersFlagsNamesAndValues) {
  const auto v = checked(
      "{brightness: 7, auto_exposure: manual_mode, power_line_frequency: 50 Hz, white_balance_automatic: "
      "false, "
      "focus_absolute: 10, iris: 28, reset: true}");
  ASSERT_TRUE(v) << v.error().text();
  ASSERT_EQ(v->size(), 7u);
  EXPECT_EQ((*v)[0].value, 7);
  EXPECT_EQ((*v)[1].value, 1);
  EXPECT_EQ((*v)[2].value, 1);
  EXPECT_EQ((*v)[3].value, 0);
  EXPECT_EQ((*v)[4].value, 10);
  EXPECT_EQ((*v)[5].value, 1);
  EXPECT_EQ((*v)[6].value, 1);
}

TEST(Controls, SayWhatThereIsWhereTheNameIsWrong) {
  const auto v = checked("{brigthness: 7}");
  ASSERT_FALSE(v);
  EXPECT_EQ(v.error().code, ErrorCode::bad_input);
  EXPECT_THAT(v.error().text(), HasSubstr("rig.yaml:1:"));
  EXPECT_THAT(v.error().text(), HasSubstr("did you mean brightness?"));
  EXPECT_THAT(v.error().text(), HasSubstr("focus_absolute (0 … 255 in steps of 5)"));
  EXPECT_THAT(v.error().text(), HasSubstr("auto_exposure (one of manual_mode, aperture_priority_mode)"));
}

TEST(Controls, KeepToRangesStepsAndMenus) {
  EXPECT_THAT(checked("{brightness: 256}").error().text(), HasSubstr("expected 0 … 255, got 256"));
  EXPECT_THAT(checked("{focus_absolute: 12}").error().text(), HasSubstr("next below is 10"));
  EXPECT_THAT(checked("{auto_exposure: 2}").error().text(), HasSubstr("one of manual_mode"));
  EXPECT_THAT(checked("{iris: 1}").error().text(), HasSubstr("one of 14, 28, 56"));
  EXPECT_THAT(checked("{temperature: 1}").error().text(), HasSubstr("only be read"));
  EXPECT_FALSE(checked("{white_balance_automatic: maybe}"));
}

TEST(Controls, AreNamedAsV4l2CtlNamesThem) {
  EXPECT_EQ(control_key("Exposure Time, Absolute"), "exposure_time_absolute");
  EXPECT_EQ(control_key("White Balance, Automatic"), "white_balance_automatic");
  EXPECT_EQ(control_key("Limited RGB Range (16-235)"), "limited_rgb_range_16_235");
}

}  // namespace
}  // namespace rigor::v4l2
