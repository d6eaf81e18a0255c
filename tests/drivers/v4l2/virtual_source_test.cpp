// The stand-in in virtual time: formats, instants, losses, and that two runs are the same.
#include "tests/drivers/v4l2/v4l2_test_tools.h"

namespace rigor::v4l2 {
namespace {

using testing::HasSubstr;

struct Taken {
  std::vector<std::vector<std::byte>> pictures;
  std::vector<Stamp> stamps;
  std::vector<ImageInfo> infos;
};

std::unique_ptr<VirtualSource> source(const DeviceParts& parts, const std::string& camera) {
  return std::make_unique<VirtualSource>(parts, test::config(camera).params);
}
Taken run(VirtualSource& s, int cycles, Duration cycle = milliseconds(1)) {
  Taken r;
  ArmContext context;
  context.virtual_time = true;
  auto status = s.arm(context);
  EXPECT_TRUE(status) << status.error().text();
  if (!status) return r;
  EXPECT_TRUE(s.start(BenchTime(0)));
  for (int i = 0; i < cycles; ++i) {
    const BenchTime now = BenchTime(0) + cycle * i;
    s.complete_until(now);
    while (const SampleLease sample = s.poll(now)) {
      EXPECT_LE(sample->stamp.t_release, now);
      r.pictures.emplace_back(sample->bytes().begin(), sample->bytes().end());
      r.stamps.push_back(sample->stamp);
      r.infos.push_back(*sample->as<ImageInfo>());
    }
  }
  EXPECT_TRUE(s.stop());
  return r;
}

TEST(V4l2VirtualSource, GivesTheCamerasPicturesOnTheGridInEveryFormat) {
  const struct {
    const char *camera, *pixels;
    PixelFormat format;
  } cases[] = {{"GREY", "Mono8", PixelFormat::mono8},
               {"Y10", "Mono10", PixelFormat::mono10},
               {"Y16", "Mono16", PixelFormat::mono16},
               {"YUYV", "YUV422_8", PixelFormat::yuv422_8},
               {"RGGB", "BayerRG8", PixelFormat::bayer_rg8},
               {"RGB3", "RGB8", PixelFormat::rgb8},
               {"NV12", "YCbCr420_8_YY_CbCr_Semiplanar", PixelFormat::yuv420_sp}};
  for (const auto& c : cases)
    for (const char* event : {"end_of_frame", "start_of_exposure"}) {
      auto s = source(test::parts_of(32, 16), std::string("{formats: [") + c.camera +
                                                  "], readout_us: 6000, timestamp: " + event + "}");
      ASSERT_TRUE(s->configure(
          test::config(std::string("{device: camera, readout_us: 6000, pixel_format: ") + c.pixels + "}")));
      const Taken r = run(*s, 400);
      ASSERT_EQ(r.stamps.size(), 9u) << c.camera;  // released at 60, 100 … 380 ms
      for (std::size_t i = 0; i < r.stamps.size(); ++i) {
        std::vector<std::byte> expected(image_bytes(c.format, 32, 16));
        test::FormulaCamera::fill(i, expected);
        EXPECT_EQ(r.pictures[i], expected) << c.camera << " " << i;
        EXPECT_EQ(r.stamps[i].t_capture, BenchTime(0) + milliseconds(40) * static_cast<std::int64_t>(i))
            << event;
        EXPECT_EQ(r.stamps[i].sequence, i);
        EXPECT_EQ(r.stamps[i].validity, kValid);
        EXPECT_EQ(r.infos[i].exposure, milliseconds(2));
      }
    }
}

TEST(V4l2VirtualSource, RepeatsItselfBitForBit) {
  const auto once = [] {
    auto s = source(test::parts_of(32, 16), "{formats: [YUYV]}");
    EXPECT_TRUE(s->configure(test::config("{device: camera, pixel_format: RGB8}")));
    return run(*s, 500).pictures;
  };
  const auto a = once(), b = once();
  EXPECT_EQ(a, b);
  EXPECT_EQ(a.size(), 11u);
}

TEST(V4l2VirtualSource, LosesNothingOverLongSteps) {
  auto s = source(test::parts_of(32, 16), "{formats: [GREY]}");
  ASSERT_TRUE(s->configure(test::config("{device: camera, pixel_format: Mono8, queue: 2, buffers: 64}")));
  const Taken r = run(*s, 5, milliseconds(400));
  EXPECT_EQ(r.stamps.size(), 39u);
  EXPECT_EQ(s->health().lost, 0u);
}

TEST(V4l2VirtualSource, SetsTheExposureThatTheRigAsks) {
  DeviceParts parts = test::parts_of(32, 16);
  auto s = source(parts, "{formats: [GREY]}");
  ASSERT_TRUE(s->configure(test::config("{device: camera, controls: {exposure_time_absolute: 75}}")));
  const Taken r = run(*s, 200);
  ASSERT_FALSE(r.infos.empty());
  EXPECT_EQ(r.infos[0].exposure, microseconds(7500));
  EXPECT_EQ(static_cast<test::FormulaCamera&>(*parts.image).last.exposure, microseconds(7500));
  EXPECT_EQ(r.stamps[0].t_capture, BenchTime(0));
}

#ifdef RIGOR_V4L2_WITH_JPEG
TEST(V4l2VirtualSource, DecodesJpeg) {
  auto s = source(test::parts_of(32, 16), "{formats: [MJPG], jpeg_quality: 100}");
  ASSERT_TRUE(s->configure(test::config("{device: camera, pixel_format: RGB8}")));
  const Taken r = run(*s, 200);
  ASSERT_EQ(r.pictures.size(), 4u);
  EXPECT_EQ(r.stamps[0].validity, kValid);
  EXPECT_EQ(s->health().incomplete, 0u);
}
#endif

Error arm_error(const std::string& camera, const std::string& params, Duration period = milliseconds(40)) {
  auto s = source(test::parts_of(32, 16), camera);
  auto status = s->configure(test::config(params, period));
  if (!status) return status.error();
  ArmContext context;
  context.virtual_time = true;
  status = s->arm(context);
  EXPECT_FALSE(status);
  return status ? Error{} : status.error();
}

TEST(V4l2VirtualSource, SaysWhatTheCameraOffers) {
  EXPECT_THAT(arm_error("{formats: [GREY]}", "{device: c, pixel_format: Coord3D_C16}").text(),
              HasSubstr("it offers GREY"));
  EXPECT_THAT(arm_error("{formats: [GREY]}", "{device: c, width_px: 64, height_px: 48}").text(),
              HasSubstr("32x16; got 64x48"));
  EXPECT_THAT(arm_error("{formats: [GREY], rate_hz: 30}", "{device: c}").text(),
              HasSubstr("30 Hz; got 25 Hz"));
  EXPECT_THAT(arm_error("{formats: [GREY]}", "{device: c, controls: {gain: 1}}").text(),
              HasSubstr("exposure_time_absolute (1 … 100000)"));
  EXPECT_THAT(arm_error("{formats: [GREY]}", "{device: c, pixel_format: Mono12p}").text(),
              HasSubstr("pixel_format"));
  EXPECT_THAT(arm_error("{formats: [GREY]}", "{device: c, device_format: TOOLONG}").text(),
              HasSubstr("device_format"));
}

TEST(EmulatedCapture, DropsWhatFindsNoBufferAndCountsOn) {
  auto settings = read_emulated_video(test::config("{formats: [GREY]}").params, "c", milliseconds(40));
  auto pictures = EmulatedPictures::create(settings, test::parts_of(32, 16), "c");
  ASSERT_TRUE(pictures);
  EmulatedCapture device(settings, std::move(*pictures));
  device.set_grid(BenchTime(0), milliseconds(40));
  ASSERT_TRUE(device.start(2));
  while (device.advance(BenchTime(0) + milliseconds(170))) {
  }
  RawFrame a, b;
  ASSERT_EQ(device.next(a), FrameStatus::frame);
  ASSERT_EQ(device.next(b), FrameStatus::frame);
  EXPECT_EQ(device.next(b), FrameStatus::none);
  EXPECT_EQ(device.dropped(), 3u);
  device.release(a);
  device.release(b);
  ASSERT_TRUE(device.advance(BenchTime(0) + milliseconds(210)));
  ASSERT_EQ(device.next(a), FrameStatus::frame);
  EXPECT_EQ(a.sequence, 5u);
}

}  // namespace
}  // namespace rigor::v4l2
