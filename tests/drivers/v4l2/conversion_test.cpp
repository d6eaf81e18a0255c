#include "drivers/v4l2/frame_conversion.h"

#include <random>

#include "drivers/v4l2/jpeg_codec.h"
#include "drivers/v4l2/mjpeg_frame.h"
#include "sensor-hal/types/yuv.h"
#include "tests/drivers/v4l2/v4l2_test_tools.h"

namespace rigor::v4l2 {
namespace {

using Pixels = std::vector<std::byte>;

Pixels bytes(std::initializer_list<int> values) {
  Pixels p;
  for (const int v : values) p.push_back(static_cast<std::byte>(v));
  return p;
}
Pixels converted(std::uint32_t code, std::uint32_t w, std::uint32_t h, std::uint32_t stride, PixelFormat to,
                 const Pixels& frame, Converted expected = Converted::good) {
  FrameConverter c({.code = code, .width_px = w, .height_px = h, .stride_bytes = stride}, to);
  Pixels out(image_bytes(to, w, h), std::byte{0x55});
  EXPECT_EQ(c.convert(frame, out), expected);
  return out;
}

// Values of ITU-R BT.601 by hand: white, black and the primaries at 100 %.
TEST(Yuv, HasTheValuesOfBt601) {
  struct Case {
    int r, g, b, y, u, v;
  };
  for (const Case& c :
       {Case{255, 255, 255, 235, 128, 128}, Case{0, 0, 0, 16, 128, 128}, Case{255, 0, 0, 82, 90, 240},
        Case{0, 255, 0, 145, 54, 34}, Case{0, 0, 255, 41, 240, 110}}) {
    // The integers are within 1 of the real numbers, rounded.
    EXPECT_NEAR(yuv::luma(c.r, c.g, c.b), c.y, 1);
    EXPECT_NEAR(yuv::cb(c.r, c.g, c.b), c.u, 1);
    EXPECT_NEAR(yuv::cr(c.r, c.g, c.b), c.v, 1);
    const auto rgb = yuv::rgb(c.y, c.u, c.v);
    EXPECT_NEAR(rgb[0], c.r, 2);
    EXPECT_NEAR(rgb[1], c.g, 2);
    EXPECT_NEAR(rgb[2], c.b, 2);
  }
}

TEST(Yuv, ComesBackWithinThreeForEveryColour) {
  int worst = 0;
  for (int r = 0; r < 256; r += 3)
    for (int g = 0; g < 256; g += 3)
      for (int b = 0; b < 256; b += 3) {
        const auto back = yuv::rgb(yuv::luma(r, g, b), yuv::cb(r, g, b), yuv::cr(r, g, b));
        worst = std::max({worst, std::abs(back[0] - r), std::abs(back[1] - g), std::abs(back[2] - b)});
      }
  EXPECT_LE(worst, 3);
}

TEST(Conversion, LeavesOutThePaddingOfRows) {
  EXPECT_EQ(converted(kGrey, 3, 2, 4, PixelFormat::mono8, bytes({1, 2, 3, 99, 4, 5, 6, 99})),
            bytes({1, 2, 3, 4, 5, 6}));
  EXPECT_EQ(converted(kZ16, 1, 2, 4, PixelFormat::coord3d_c16, bytes({1, 2, 99, 99, 3, 4, 99, 99})),
            bytes({1, 2, 3, 4}));
}

TEST(Conversion, KnowsTheOrderOfBytes) {
  EXPECT_EQ(converted(kY16Be, 2, 1, 4, PixelFormat::mono16, bytes({1, 2, 3, 4})), bytes({2, 1, 4, 3}));
  EXPECT_EQ(converted(kUyvy, 2, 1, 4, PixelFormat::yuv422_8, bytes({10, 20, 30, 40})),
            bytes({20, 10, 40, 30}));
  EXPECT_EQ(converted(kBgr3, 2, 1, 6, PixelFormat::rgb8, bytes({1, 2, 3, 4, 5, 6})),
            bytes({3, 2, 1, 6, 5, 4}));
  // Y U Y V and U Y V Y carry the same colours.
  const auto yuyv = converted(kYuyv, 2, 1, 4, PixelFormat::rgb8, bytes({82, 90, 145, 240}));
  EXPECT_EQ(yuyv, converted(kUyvy, 2, 1, 4, PixelFormat::rgb8, bytes({90, 82, 240, 145})));
  EXPECT_NEAR(std::to_integer<int>(yuyv[0]), 255, 2);
  EXPECT_NEAR(std::to_integer<int>(yuyv[1]), 0, 2);
}

TEST(Conversion, FindsThePlanesOf420) {
  // 4x2, stride 6: Y, then one row of chroma.
  const Pixels nv12 = bytes({81, 82, 83, 84, 0, 0, 91, 92, 93, 94, 0, 0, 100, 110, 120, 130, 0, 0});
  EXPECT_EQ(converted(kNv12, 4, 2, 6, PixelFormat::yuv420_sp, nv12),
            bytes({81, 82, 83, 84, 91, 92, 93, 94, 100, 110, 120, 130}));
  const Pixels yu12 = bytes({81, 82, 83, 84, 0, 0, 91, 92, 93, 94, 0, 0, 100, 120, 0, 110, 130, 0});
  EXPECT_EQ(converted(kYu12, 4, 2, 6, PixelFormat::yuv420_sp, yu12),
            bytes({81, 82, 83, 84, 91, 92, 93, 94, 100, 110, 120, 130}));
  EXPECT_EQ(converted(kNv12, 4, 2, 6, PixelFormat::rgb8, nv12),
            converted(kYu12, 4, 2, 6, PixelFormat::rgb8, yu12));
  const auto rgb = converted(kNv12, 4, 2, 6, PixelFormat::rgb8, nv12);
  const auto expected = yuv::rgb(94, 120, 130);
  for (std::size_t k = 0; k < 3; ++k) EXPECT_EQ(std::to_integer<int>(rgb[21 + k]), expected[k]);
}

/// Devices crop to odd sizes, too. The frame and the target are exactly as long as they must be: a byte
/// beyond is seen by the address sanitizer, and a byte that was not written is still 0x55.
TEST(Conversion, WritesTheLastColumnAndRowOfOddSizes) {
  const auto pixel = [](const Pixels& p, std::size_t i) {
    return std::array<int, 3>{std::to_integer<int>(p[3 * i]), std::to_integer<int>(p[3 * i + 1]),
                              std::to_integer<int>(p[3 * i + 2])};
  };
  const auto rgb = [](int y, int u, int v) {
    const auto c = yuv::rgb(y, u, v);
    return std::array<int, 3>{c[0], c[1], c[2]};
  };
  const auto yuyv = converted(kYuyv, 3, 1, 6, PixelFormat::rgb8, bytes({81, 90, 82, 240, 145, 54}));
  EXPECT_EQ(pixel(yuyv, 1), rgb(82, 90, 240));
  EXPECT_EQ(pixel(yuyv, 2), rgb(145, 54, 240));  // its own U; the V of the pair before
  const auto uyvy = converted(kUyvy, 3, 1, 6, PixelFormat::rgb8, bytes({90, 81, 240, 82, 54, 145}));
  EXPECT_EQ(uyvy, yuyv);
  EXPECT_EQ(pixel(converted(kYuyv, 1, 1, 2, PixelFormat::rgb8, bytes({81, 90})), 0), rgb(81, 90, 128));
  // 3x3, stride 4: chroma of 2x2.
  const Pixels luma = bytes({81, 82, 83, 0, 84, 85, 86, 0, 87, 88, 89, 0});
  Pixels nv12 = luma, yu12 = luma;
  for (const std::byte b : bytes({100, 110, 101, 111, 102, 112, 103, 113})) nv12.push_back(b);
  for (const std::byte b : bytes({100, 101, 102, 103, 110, 111, 112, 113})) yu12.push_back(b);
  const auto semiplanar = converted(kNv12, 3, 3, 4, PixelFormat::rgb8, nv12);
  EXPECT_EQ(semiplanar, converted(kYu12, 3, 3, 4, PixelFormat::rgb8, yu12));
  EXPECT_EQ(pixel(semiplanar, 2), rgb(83, 101, 111));
  EXPECT_EQ(pixel(semiplanar, 8), rgb(89, 103, 113));
}

TEST(Conversion, StretchesLumaToGrey) {
  EXPECT_EQ(converted(kYuyv, 2, 1, 4, PixelFormat::mono8, bytes({16, 1, 235, 2})), bytes({0, 255}));
  EXPECT_EQ(converted(kUyvy, 2, 1, 4, PixelFormat::mono8, bytes({1, 16, 2, 235})), bytes({0, 255}));
}

TEST(Conversion, MarksShortFramesAndZeroesWhatIsMissing) {
  EXPECT_EQ(converted(kGrey, 2, 2, 2, PixelFormat::mono8, bytes({7, 8, 9}), Converted::incomplete),
            bytes({7, 8, 0, 0}));
  EXPECT_EQ(converted(kNv12, 2, 2, 2, PixelFormat::yuv420_sp, bytes({7, 8, 9, 10}), Converted::incomplete),
            bytes({7, 8, 9, 10, 0, 0}));
  EXPECT_EQ(converted(kYu12, 2, 2, 2, PixelFormat::rgb8, bytes({7, 8, 9, 10, 1}), Converted::incomplete),
            Pixels(12, std::byte{0}));
  (void)converted(kGrey, 2, 2, 2, PixelFormat::mono8, {}, Converted::refused);
}

// What an emulated camera sends, its reader turns back into the picture.
TEST(Conversion, TurnsBackWhatAnEmulatedCameraSends) {
  constexpr std::uint32_t kW = 16, kH = 8;
  for (const std::uint32_t code :
       {kGrey, kY10, kY12, kY16, kYuyv, kUyvy, kNv12, kRgb3, kBgr3, kRggb, kRg10, kZ16}) {
    const PixelFormat format = made_from(code).value();
    Pixels picture(image_bytes(format, kW, kH));
    test::FormulaCamera::fill(5, picture);
    FrameMaker maker(code, kW, kH, 90);
    Pixels frame(frame_bytes(code, kW, kH));
    ASSERT_EQ(maker.make(picture, frame), frame.size()) << fourcc_text(code);
    EXPECT_EQ(converted(code, kW, kH, frame_stride(code, kW), format, frame), picture) << fourcc_text(code);
  }
}

TEST(Depth, IsTheRangeAlongTheAxis) {
  const float ranges[4] = {1.0F, std::sqrt(2.0F), std::nanf(""), 100.0F};
  Pixels out(8);
  depth_from_range(std::as_bytes(std::span(ranges)), 2, 2,
                   {.fx_px = 1, .fy_px = 1, .cx_px = 0, .cy_px = 0, .unit_m = 0.001}, out);
  const auto z = [&](std::size_t i) {
    return std::to_integer<int>(out[2 * i]) | std::to_integer<int>(out[2 * i + 1]) << 8;
  };
  EXPECT_EQ(z(0), 1000);
  EXPECT_EQ(z(1), 1000);  // one pixel to the right at 45 degrees
  EXPECT_EQ(z(2), 0);
  EXPECT_EQ(z(3), 57735);  // 100 m / √3
}

#ifdef RIGOR_V4L2_WITH_JPEG
Pixels smooth(std::uint32_t w, std::uint32_t h) {
  Pixels p(image_bytes(PixelFormat::rgb8, w, h));
  for (std::size_t i = 0; i < p.size() / 3; ++i) {
    const std::size_t x = i % w, y = i / w;
    p[3 * i] = static_cast<std::byte>(x * 255 / w), p[3 * i + 1] = static_cast<std::byte>(y * 255 / h);
    p[3 * i + 2] = static_cast<std::byte>(128);
  }
  return p;
}
Pixels jpeg(const Pixels& picture, std::uint32_t w, std::uint32_t h, int quality = 95) {
  JpegCodec codec;
  const auto f = codec.encode(picture, PixelFormat::rgb8, w, h, quality);
  return {f.begin(), f.end()};
}
/// As UVC cameras send them: without Huffman tables.
Pixels without_tables(const Pixels& frame) {
  Pixels out(frame.begin(), frame.begin() + 2);
  for (std::size_t i = 2; i + 4 <= frame.size();) {
    const auto marker = std::to_integer<int>(frame[i + 1]);
    const std::size_t length = static_cast<std::size_t>(std::to_integer<int>(frame[i + 2]) << 8 |
                                                        std::to_integer<int>(frame[i + 3]));
    if (marker != 0xC4)
      out.insert(out.end(), frame.begin() + static_cast<long>(i),
                 frame.begin() + static_cast<long>(i + 2 + length));
    i += 2 + length;
    if (marker == 0xDA) {
      out.insert(out.end(), frame.begin() + static_cast<long>(i), frame.end());
      break;
    }
  }
  return out;
}

TEST(Mjpeg, TellsSizeAndWholenessFromMarkers) {
  const Pixels frame = jpeg(smooth(48, 32), 48, 32);
  MjpegFrame f = read_mjpeg(frame);
  EXPECT_EQ(f.verdict, MjpegFrame::Verdict::whole);
  EXPECT_EQ(f.width_px, 48u);
  EXPECT_EQ(f.height_px, 32u);
  EXPECT_EQ(f.components, 3);
  EXPECT_TRUE(f.own_huffman_tables);
  EXPECT_EQ(f.size_bytes, frame.size());
  Pixels padded = frame;
  padded.resize(frame.size() + 100);
  EXPECT_EQ(read_mjpeg(padded).size_bytes, frame.size());
  EXPECT_FALSE(read_mjpeg(without_tables(frame)).own_huffman_tables);
  EXPECT_EQ(read_mjpeg(std::span(frame).first(frame.size() - 2)).verdict, MjpegFrame::Verdict::truncated);
  EXPECT_EQ(read_mjpeg(bytes({0xFF, 0xD8, 0xFF, 0xD9})).verdict, MjpegFrame::Verdict::broken);
  for (std::size_t n = 0; n < frame.size(); ++n)
    EXPECT_NE(read_mjpeg(std::span(frame).first(n)).verdict, MjpegFrame::Verdict::whole) << n;
}

TEST(Mjpeg, IsDecodedWithAndWithoutItsOwnTables) {
  const Pixels picture = smooth(48, 32), frame = jpeg(picture, 48, 32);
  const Pixels out = converted(kMjpg, 48, 32, 0, PixelFormat::rgb8, frame);
  int worst = 0;
  for (std::size_t i = 0; i < out.size(); ++i)
    worst = std::max(worst, std::abs(std::to_integer<int>(out[i]) - std::to_integer<int>(picture[i])));
  EXPECT_LE(worst, 12);  // quality 95 on gradients, chroma at half the width
  // libjpeg-turbo writes the tables of annex K.3, so the frame without them means the same.
  EXPECT_EQ(converted(kMjpg, 48, 32, 0, PixelFormat::rgb8, without_tables(frame)), out);
  const Pixels grey = converted(kMjpg, 48, 32, 0, PixelFormat::mono8, frame);
  EXPECT_NEAR(std::to_integer<int>(grey[0]), (114 * 128) / 1000, 6);
}

TEST(Mjpeg, OfAnotherSizeOrCutShortIsNotTakenForWhole) {
  const Pixels frame = jpeg(smooth(48, 32), 48, 32);
  (void)converted(kMjpg, 32, 32, 0, PixelFormat::rgb8, frame, Converted::refused);
  const Pixels cut(frame.begin(), frame.begin() + static_cast<long>(frame.size() * 2 / 3));
  (void)converted(kMjpg, 48, 32, 0, PixelFormat::rgb8, cut, Converted::incomplete);
  (void)converted(kMjpg, 48, 32, 0, PixelFormat::rgb8, bytes({1, 2, 3, 4}), Converted::refused);
  // The codec goes on after a broken frame.
  FrameConverter c({.code = kMjpg, .width_px = 48, .height_px = 32}, PixelFormat::rgb8);
  Pixels out(image_bytes(PixelFormat::rgb8, 48, 32));
  for (int round = 0; round < 3; ++round) {
    EXPECT_EQ(c.convert(cut, out), Converted::incomplete);
    EXPECT_EQ(c.convert(frame, out), Converted::good);
  }
}

/// One for each component at most: libjpeg decodes all scans of a frame before its first row is there.
TEST(Mjpeg, OfMoreScansThanComponentsIsRefusedBeforeItIsDecoded) {
  const Pixels frame = jpeg(smooth(48, 32), 48, 32);
  std::size_t scan = 0;
  for (std::size_t i = 2; std::to_integer<int>(frame[i + 1]) != 0xDA; scan = i)
    i += 2 + static_cast<std::size_t>(std::to_integer<int>(frame[i + 2]) << 8 |
                                      std::to_integer<int>(frame[i + 3]));
  Pixels many(frame.begin(), frame.end() - 2);
  for (int k = 0; k < 3; ++k)
    many.insert(many.end(), frame.begin() + static_cast<long>(scan), frame.end() - 2);
  many.insert(many.end(), frame.end() - 2, frame.end());
  EXPECT_EQ(read_mjpeg(frame).scans, 1u);
  ASSERT_EQ(read_mjpeg(many).scans, 4u);
  JpegCodec codec;
  Pixels out(image_bytes(PixelFormat::rgb8, 48, 32));
  EXPECT_EQ(codec.decode(many, PixelFormat::rgb8, 48, 32, out), JpegCodec::Decoded::refused);
  EXPECT_EQ(codec.decode(frame, PixelFormat::rgb8, 48, 32, out), JpegCodec::Decoded::good);
}

TEST(Mjpeg, GrowsItsMemoryForLargerFrames) {
  JpegCodec codec;
  std::mt19937 random(7);
  for (const std::uint32_t w : {16u, 64u, 256u, 32u, 512u}) {
    Pixels noise(image_bytes(PixelFormat::rgb8, w, w));
    for (auto& b : noise) b = static_cast<std::byte>(random());
    const auto f = codec.encode(noise, PixelFormat::rgb8, w, w, 100);
    ASSERT_FALSE(f.empty());
    EXPECT_EQ(read_mjpeg(f).verdict, MjpegFrame::Verdict::whole);
    EXPECT_LE(f.size(), frame_bytes(kMjpg, w, w));
  }
}
#endif

}  // namespace
}  // namespace rigor::v4l2
