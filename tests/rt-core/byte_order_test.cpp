#include "rt-core/byte_order.h"

#include <gtest/gtest.h>

#include <array>
#include <limits>
#include <span>
#include <vector>

namespace rigor {
namespace {

constexpr std::array<std::uint8_t, 9> kBytes{0xFF, 0x81, 0x02, 0x03, 0x84, 0x05, 0x06, 0x07, 0x88};

TEST(ByteOrder, LoadsEachWidthFromAnyOffset) {
  static_assert(load_be<std::uint32_t>(kBytes, 1) == 0x81020384u &&
                load_le<std::int16_t>(kBytes, 1) == 0x0281);
  EXPECT_EQ(load_be<std::uint8_t>(kBytes, 1), 0x81);
  EXPECT_EQ(load_be<std::uint16_t>(kBytes, 1), 0x8102);
  EXPECT_EQ(load_le<std::uint16_t>(kBytes, 1), 0x0281);
  EXPECT_EQ(load_be<std::uint32_t>(kBytes, 1), 0x81020384u);
  EXPECT_EQ(load_le<std::uint32_t>(kBytes, 1), 0x84030281u);
  EXPECT_EQ(load_be<std::uint64_t>(kBytes, 1), 0x8102038405060788u);
  EXPECT_EQ(load_le<std::uint64_t>(kBytes, 1), 0x8807060584030281u);
}

TEST(ByteOrder, KeepsSignsAndFloats) {
  EXPECT_EQ(load_be<std::int16_t>(kBytes, 1), std::int16_t{-32510});
  EXPECT_EQ(load_le<std::int32_t>(kBytes, 1), std::int32_t{-2080177535});
  std::array<std::byte, 8> b{};
  store_be(b, 0, -0.1);
  EXPECT_EQ(load_be<double>(b), -0.1);
  EXPECT_EQ(std::to_integer<int>(b[0]), 0xBF);
  store_le(b, 4, std::numeric_limits<float>::infinity());
  EXPECT_EQ(load_le<float>(b, 4), std::numeric_limits<float>::infinity());
  EXPECT_EQ(std::to_integer<int>(b[7]), 0x7F);
}

TEST(ByteOrder, StoresWhatItLoadsAndNothingBeside) {
  std::vector<std::uint8_t> out(6, 0xEE);
  store_be(std::span(out), 1, std::uint32_t{0x01020304});
  EXPECT_EQ(out, (std::vector<std::uint8_t>{0xEE, 1, 2, 3, 4, 0xEE}));
  store_le(std::span(out), 1, std::uint32_t{0x01020304});
  EXPECT_EQ(out, (std::vector<std::uint8_t>{0xEE, 4, 3, 2, 1, 0xEE}));
}

TEST(ByteOrder, AppendsToGrowingContainers) {
  std::vector<std::uint8_t> out;
  append_be(out, std::uint16_t{0x0102});
  append_le(out, std::int32_t{-2});
  EXPECT_EQ(out, (std::vector<std::uint8_t>{1, 2, 0xFE, 0xFF, 0xFF, 0xFF}));
  std::string text;
  append_be(text, std::uint16_t{0x4142});
  EXPECT_EQ(text, "AB");
}

}  // namespace
}  // namespace rigor
