// Frames as pictures: where a pixel lies, what it says, and what is missing.
#include "drivers/ouster/frame_image.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "drivers/ouster/frame_stream.h"
#include "rt-core/byte_order.h"
#include "tests/drivers/ouster/made_sensor.h"

namespace rigor::ouster {
namespace {

using test::kBeams;
using test::made_metadata;

constexpr std::uint32_t kWidth = 512;

/// Rows that are shifted to the right, to the left, and not.
Metadata shifted(Profile profile = Profile::single) {
  Metadata m = made_metadata(profile);
  for (std::uint32_t row = 0; row < kBeams; ++row)
    m.pixel_shift[row] = static_cast<std::int32_t>(row % 4) * 6 - 6;
  return m;
}

/// Each pixel's numbers are those of its row and column.
Pixel pixel_at(std::uint32_t column, std::uint32_t row) {
  return {8 * (1000 + 3 * column + row), static_cast<std::uint16_t>(column * 32 + row),
          static_cast<std::uint8_t>(column / 2), 0};
}
std::uint16_t near_infrared_at(std::uint32_t column, std::uint32_t row) {
  return static_cast<std::uint16_t>(16 * ((column + 7 * row) % 256));
}

/// One frame, whose packets `lost` names do not come. The picture, as it was handed on.
std::vector<std::uint8_t> picture(FrameStream& stream, std::uint16_t frame,
                                  const std::vector<std::uint32_t>& lost = {}) {
  const Metadata& m = stream.metadata();
  std::vector<std::uint8_t> out;
  const packet_lidar::HandCloud hand = [&](const packet_lidar::Cloud& c) {
    EXPECT_TRUE(c.points.empty());
    out.assign(c.pixels.begin(), c.pixels.end());
  };
  LidarPacketWriter w(stream.layout());
  for (std::uint32_t slot = 0; slot < m.slots(); ++slot) {
    if (std::count(lost.begin(), lost.end(), slot) > 0) continue;
    w.set_header(frame, 0, 1);
    for (std::uint32_t i = 0; i < 16; ++i) {
      const std::uint32_t id = slot * 16 + i;
      w.set_column(i, std::uint64_t{frame} * 100'000'000 + id * 195'312, static_cast<std::uint16_t>(id),
                   m.window.has(id));
      if (!m.window.has(id)) continue;
      for (std::uint32_t row = 0; row < kBeams; ++row) {
        w.set_pixel(i, row, pixel_at(id, row));
        w.set_near_infrared(i, row, near_infrared_at(id, row));
      }
    }
    stream.take(w.bytes(), BenchTime(0), hand);
  }
  stream.finish(hand);
  return out;
}
FrameStream stream_of(const Metadata& m, const ImageOptions& image) {
  return {m, {.time = packet_lidar::TimeSource::fixed, .image = image}};
}
/// The column that lies at x.
std::uint32_t column_at(const Metadata& m, std::uint32_t x, std::uint32_t row) {
  return (x + kWidth - static_cast<std::uint32_t>(m.pixel_shift[row] + 512)) % kWidth;
}

TEST(OusterImage, HasEachPixelInItsRowShiftedByThatRowsShift) {
  const Metadata m = shifted();
  FrameStream stream = stream_of(m, {.field = Field::signal});
  const auto* info = std::get_if<ImageInfo>(&stream.image()->info());
  ASSERT_NE(info, nullptr);
  EXPECT_EQ(info->width_px, kWidth);
  EXPECT_EQ(info->height_px, kBeams);
  EXPECT_EQ(info->format, PixelFormat::mono16);
  const auto image = picture(stream, 1);
  ASSERT_EQ(image.size(), std::size_t{kWidth} * kBeams * 2);
  for (std::uint32_t row = 0; row < kBeams; ++row)
    for (std::uint32_t x = 0; x < kWidth; ++x)
      ASSERT_EQ(load_le<std::uint16_t>(image, (row * kWidth + x) * 2),
                pixel_at(column_at(m, x, row), row).signal)
          << "row " << row << " x " << x;
  // Column 0 of row 0 lies six to the left of the first, of row 3 twelve to the right.
  EXPECT_EQ(load_le<std::uint16_t>(image, (kWidth - 6) * 2), pixel_at(0, 0).signal);
  EXPECT_EQ(load_le<std::uint16_t>(image, (3 * kWidth + 12) * 2), pixel_at(0, 3).signal);
}

TEST(OusterImage, HasTheFieldThatWasAskedFor) {
  const Metadata m = shifted();
  FrameStream near_infrared = stream_of(m, {.field = Field::near_infrared});
  FrameStream reflectivity =
      stream_of(m, {.field = Field::reflectivity, .format = PixelFormat::mono8, .full_scale = 255});
  FrameStream scaled =
      stream_of(m, {.field = Field::signal, .format = PixelFormat::mono8, .full_scale = 8000});
  const auto n = picture(near_infrared, 1), r = picture(reflectivity, 1), s = picture(scaled, 1);
  ASSERT_EQ(r.size(), std::size_t{kWidth} * kBeams);
  ASSERT_EQ(s.size(), r.size());
  for (std::uint32_t row = 0; row < kBeams; ++row)
    for (std::uint32_t x = 0; x < kWidth; ++x) {
      const std::uint32_t column = column_at(m, x, row), at = row * kWidth + x;
      ASSERT_EQ(load_le<std::uint16_t>(n, at * 2), near_infrared_at(column, row));
      ASSERT_EQ(r[at], pixel_at(column, row).reflectivity);
      ASSERT_EQ(s[at], std::min(255L, std::lround(pixel_at(column, row).signal * 255 / 8000.0)));
    }
}

TEST(OusterImage, OfRangeIsInMetresWithTheSignalAsAmplitude) {
  for (const Profile profile : {Profile::single, Profile::low_data}) {
    Metadata m = shifted(profile);
    m.window = {0, 255};
    FrameStream stream = stream_of(m, {.field = Field::range});
    const auto image = picture(stream, 1);
    const std::size_t pixels = std::size_t{kWidth} * kBeams;
    ASSERT_EQ(image.size(), pixels * 8);
    for (std::uint32_t row = 0; row < kBeams; ++row)
      for (std::uint32_t x = 0; x < kWidth; ++x) {
        const std::uint32_t column = column_at(m, x, row), at = row * kWidth + x;
        const float range = load_le<float>(image, at * 4),
                    amplitude = load_le<float>(image, (pixels + at) * 4);
        if (column > 255) {
          ASSERT_TRUE(std::isnan(range)) << "outside of the window";
          continue;
        }
        ASSERT_FLOAT_EQ(range, static_cast<float>(pixel_at(column, row).range_mm) * 1e-3F);
        ASSERT_EQ(amplitude, profile == Profile::low_data ? pixel_at(column, row).reflectivity
                                                          : pixel_at(column, row).signal);
      }
  }
}

TEST(OusterImage, HasNothingOfTheFrameBeforeWhereAPacketIsLost) {
  const Metadata m = shifted();
  FrameStream stream = stream_of(m, {.field = Field::signal});
  (void)picture(stream, 1);
  const auto image = picture(stream, 2, {4});
  EXPECT_EQ(stream.counters().packets_lost, 1u);
  ASSERT_FALSE(image.empty());
  for (std::uint32_t row = 0; row < kBeams; ++row)
    for (std::uint32_t x = 0; x < kWidth; ++x) {
      const std::uint32_t column = column_at(m, x, row);
      ASSERT_EQ(load_le<std::uint16_t>(image, (row * kWidth + x) * 2),
                column / 16 == 4 ? 0 : pixel_at(column, row).signal);
    }
}

TEST(OusterImage, IsOfTheFirstReturn) {
  FrameStream stream = stream_of(made_metadata(Profile::dual), {.field = Field::reflectivity});
  LidarPacketWriter w(stream.layout());
  std::vector<std::uint8_t> image;
  for (std::uint32_t slot = 0; slot < 32; ++slot) {
    w.set_header(1, 0, 1);
    for (std::uint32_t i = 0; i < 16; ++i) {
      w.set_column(i, slot * 16 + i, static_cast<std::uint16_t>(slot * 16 + i), true);
      w.set_pixel(i, 5, {5000, 1, 77, 0});
      w.set_pixel(i, 5, {7000, 1, 99, 0}, 1);
    }
    stream.take(w.bytes(), BenchTime(0),
                [&](const packet_lidar::Cloud& c) { image.assign(c.pixels.begin(), c.pixels.end()); });
  }
  ASSERT_EQ(image.size(), std::size_t{kWidth} * kBeams * 2);
  EXPECT_EQ(load_le<std::uint16_t>(image, (5 * kWidth + 100) * 2), 77);
}

TEST(OusterImage, OfSignalNeedsAProfileThatHasIt) {
  EXPECT_TRUE(check_field(Profile::low_data, Field::near_infrared));
  EXPECT_TRUE(check_field(Profile::legacy, Field::signal));
  const auto refused = check_field(Profile::low_data, Field::signal);
  ASSERT_FALSE(refused);
  EXPECT_NE(refused.error().text().find("RNG15_RFL8_NIR8"), std::string::npos);
  // Nor does a stream take up a sensor whose images it cannot make.
  Metadata m = shifted();
  FrameStream stream = stream_of(m, {.field = Field::signal});
  EXPECT_FALSE(stream.adopt(shifted(Profile::low_data)));
  EXPECT_FALSE(stream.adopt(made_metadata(Profile::single, {1024, 10})));
  m.window = {0, 99};
  EXPECT_TRUE(stream.adopt(m));
}

}  // namespace
}  // namespace rigor::ouster
