// Frames of several parts over loopback, by way of Aravis: range and amplitude of a 3D camera that a range
// channel leaves the bench as, and one of its pictures by itself.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstring>

#include "drivers/aravis/aravis_source.h"
#include "drivers/aravis/gige_channel_emulator.h"
#include "tests/drivers/aravis/aravis_test_tools.h"
#include "tests/drivers/aravis/range_pictures.h"

namespace rigor {
namespace {

using ::testing::HasSubstr;
using testing::make_config;
using testing::RangePictures;

class GigeParts : public ::testing::Test {
 protected:
  static constexpr std::size_t kPixels = RangePictures::kWidth * RangePictures::kHeight;
  void SetUp() override {
    DeviceParts parts;
    parts.samples = std::make_shared<RangePictures>();
    emulator_.attach(parts);
    const auto s = emulator_.configure(make_config(
        "{address: 127.0.0.63, serial: tof63, rate_hz: 25, range_scale_mm: 0.2, amplitude_scale: 0.5}"));
    ASSERT_TRUE(s) << s.error().text();
    const auto armed = emulator_.arm({});
    ASSERT_TRUE(armed) << armed.error().text();
    EXPECT_EQ(emulator_.describe().kind, SampleKind::range_image);
    ASSERT_TRUE(emulator_.start(testing::now()));
  }
  void TearDown() override { EXPECT_TRUE(emulator_.stop()); }
  static Status start(AravisSource& source, SampleKind kind, const std::string& keys) {
    ChannelConfig c = make_config(keys);
    c.kind = kind;
    Status s;
    const auto made = catch_config([&] { return s = source.configure(c), true; });
    if (!made) return tl::unexpected<Error>(made.error());
    if (s) s = source.arm({});
    if (s) s = source.start(testing::now());
    return s;
  }
  /// Some samples, at most 20 s long.
  static std::vector<SampleLease> some(AravisSource& source, std::size_t n) {
    std::vector<SampleLease> all;
    for (const auto end = testing::now() + seconds(20); testing::now() < end && all.size() < n; usleep(1000))
      while (auto s = source.poll(testing::now())) all.push_back(std::move(s));
    return all;
  }
  GigeChannelEmulator emulator_;
};

TEST_F(GigeParts, RangeAndAmplitudeComeAsOneRangeImage) {
  AravisSource source;
  const auto s = start(source, SampleKind::range_image,
                       "{device: Rigor-tof63, exposure_us: 2000, amplitude_scale: 0.5, buffers: 24}");
  ASSERT_TRUE(s) << s.error().text();
  EXPECT_EQ(source.describe().kind, SampleKind::range_image);
  EXPECT_EQ(source.describe().width_px, RangePictures::kWidth);
  EXPECT_EQ(source.describe().max_bytes, kPixels * 2 * sizeof(float));
  const auto seen = some(source, 8);
  ASSERT_EQ(seen.size(), 8u);
  for (const auto& lease : seen) {
    ASSERT_EQ(lease->kind(), SampleKind::range_image);
    ASSERT_EQ(lease->bytes().size(), kPixels * 2 * sizeof(float));
    EXPECT_EQ(lease->stamp.validity, kValid);
    const auto* f = reinterpret_cast<const float*>(lease->bytes().data());
    // The frame's own number is in its amplitudes; range and amplitude must be of one frame.
    const auto index = static_cast<std::uint64_t>(std::lround(f[kPixels] / 0.5F));
    for (std::size_t i = 0; i < kPixels; ++i) {
      const float truth = RangePictures::range_m(i, index);
      if (std::isnan(truth))
        EXPECT_TRUE(std::isnan(f[i])) << i;
      else
        EXPECT_NEAR(f[i], truth, 0.00011) << i;  // half a count
      EXPECT_EQ(f[kPixels + i], RangePictures::amplitude(i, index)) << i;
    }
  }
  EXPECT_EQ(source.health().protocol_errors, 0u);
  EXPECT_TRUE(source.warnings().empty());
  ASSERT_TRUE(source.stop());
}

TEST_F(GigeParts, OnePartByItsNameOrItsNumberIsAnImage) {
  struct Case {
    const char *part, *format;
    bool range;
  };
  for (const Case& c : {Case{"Intensity", "Mono16", false}, Case{"Range", "Coord3D_C16", true},
                        Case{"1", "Mono16", false}, Case{"0", "Coord3D_C16", true}}) {
    AravisSource source;
    const auto s =
        start(source, SampleKind::image,
              std::string("{address: 127.0.0.63, part: ") + c.part + ", pixel_format: " + c.format + "}");
    ASSERT_TRUE(s) << c.part << ": " << s.error().text();
    const auto seen = some(source, 2);
    ASSERT_EQ(seen.size(), 2u) << c.part << ": " << (source.warnings().empty() ? "" : source.warnings()[0]);
    const auto* info = seen[1]->as<ImageInfo>();
    ASSERT_NE(info, nullptr);
    EXPECT_EQ(info->format, c.range ? PixelFormat::coord3d_c16 : PixelFormat::mono16);
    ASSERT_EQ(seen[1]->bytes().size(), kPixels * 2);
    std::uint16_t first = 0, later = 0;
    std::memcpy(&first, seen[1]->bytes().data(), 2);
    std::memcpy(&later, seen[1]->bytes().data() + 2 * 200, 2);
    EXPECT_EQ(later - first, c.range ? 200 * 5 : 400) << c.part;
    ASSERT_TRUE(source.stop());
  }
}

TEST_F(GigeParts, WithoutPartsTheCameraSendsItsRangeAlone) {
  AravisSource source;
  const auto s = start(source, SampleKind::image, "{address: 127.0.0.63, pixel_format: Coord3D_C16}");
  ASSERT_TRUE(s) << s.error().text();
  const auto seen = some(source, 2);
  ASSERT_EQ(seen.size(), 2u);
  EXPECT_EQ(seen[0]->bytes().size(), kPixels * 2);
  ASSERT_TRUE(source.stop());
}

TEST_F(GigeParts, SaysWhatTheFramesHaveWhereThePartIsNotThere) {
  AravisSource source;
  auto s = start(source, SampleKind::image, "{address: 127.0.0.63, part: \"7\", pixel_format: Mono16}");
  ASSERT_TRUE(s) << s.error().text();  // how many parts there are, the first frame says
  for (const auto end = testing::now() + seconds(20); testing::now() < end && source.warnings().empty();)
    usleep(1000);
  ASSERT_EQ(source.warnings().size(), 1u);
  EXPECT_THAT(source.warnings()[0],
              HasSubstr("expected the part 7 of 64x48 Mono16 in each frame, got component 4, "
                        "64x48 of format 0x011000B8; component 1, 64x48 of format 0x01100007"));
  EXPECT_GE(source.health().protocol_errors, 1u);
  ASSERT_TRUE(source.stop());

  AravisSource other;
  s = start(other, SampleKind::image, "{address: 127.0.0.63, part: Infrared, pixel_format: Mono16}");
  ASSERT_FALSE(s);
  EXPECT_EQ(s.error().code, ErrorCode::bad_input);
  EXPECT_THAT(s.error().text(),
              HasSubstr("expected a component that the camera offers (Intensity, Range), got Infrared"));
}

TEST(GigePartsOfOthers, ACameraOfPicturesSaysThatItHasNoParts) {
  auto camera = testing::start_camera("127.0.0.64", "SRC64");
  for (const auto& [kind, keys, what] :
       {std::tuple(SampleKind::image, "{address: 127.0.0.64, part: Intensity}", "frames of several parts"),
        std::tuple(SampleKind::range_image, "{address: 127.0.0.64}",
                   "a camera that gives range (Coord3D_C16)")}) {
    AravisSource source;
    ChannelConfig c = make_config(keys);
    c.kind = kind;
    ASSERT_TRUE(source.configure(c));
    const auto s = source.arm({});
    ASSERT_FALSE(s);
    EXPECT_EQ(s.error().exit_status(), 2);
    EXPECT_THAT(s.error().text(), HasSubstr(what));
  }
}

}  // namespace
}  // namespace rigor
