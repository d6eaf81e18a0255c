#include "sim/render/content/texels.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>

namespace rigor::render {
namespace {

double srgb(double linear) {
  return linear <= 0.0031308 ? 12.92 * linear : 1.055 * std::pow(linear, 1 / 2.4) - 0.055;
}

TEST(SrgbBytes, AreTheNearestOnesOfTheStandardsCurve) {
  const SrgbBytes& bytes = srgb_bytes();
  for (int i = 0; i <= 1'000'000; ++i) {
    const float linear = static_cast<float>(i) / 1e6F;
    const double wanted = 255 * srgb(static_cast<double>(linear));
    // A place just between two bytes may go either way.
    ASSERT_LE(std::abs(wanted - bytes.of(linear)), 0.5001) << linear;
  }
}

TEST(SrgbBytes, ComeBackFromTheLightOfEachByte) {
  for (int byte = 0; byte < 256; ++byte) EXPECT_EQ(srgb_bytes().of(linear_of_bytes(true)[byte]), byte);
}

TEST(SrgbBytes, OfLightBeyondBlackAndWhiteAreTheLastOnes) {
  EXPECT_EQ(srgb_bytes().of(-1), 0);
  EXPECT_EQ(srgb_bytes().of(std::numeric_limits<float>::quiet_NaN()), 0);
  EXPECT_EQ(srgb_bytes().of(1.5F), 255);
  EXPECT_EQ(srgb_bytes().of(std::numeric_limits<float>::infinity()), 255);
}

TEST(Halved, KeepsCoverageAndTheLightOfWhatIsCovered) {
  std::mt19937 draw(1);
  LinearTexels in{6, 4, {}};
  double light = 0, cover = 0;
  for (int i = 0; i < 24; ++i) {
    LinearTexels::Texel t;
    for (int k = 0; k < 4; ++k) t[k] = static_cast<float>(draw() % 256) / 255;
    light += static_cast<double>(t[0] * t[3]);
    cover += static_cast<double>(t[3]);
    in.texels.push_back(t);
  }
  const LinearTexels out = halved(in, true);
  ASSERT_EQ(out.width, 3U);
  ASSERT_EQ(out.height, 2U);
  for (const LinearTexels::Texel& t : out.texels) {
    light -= static_cast<double>(4 * t[0] * t[3]);
    cover -= static_cast<double>(4 * t[3]);
  }
  EXPECT_NEAR(light, 0, 1e-4);
  EXPECT_NEAR(cover, 0, 1e-4);
}

TEST(Halved, SpreadsAnOddLastColumn) {
  LinearTexels in{5, 1, {}};
  for (int i = 0; i < 5; ++i) in.texels.push_back(LinearTexels::Texel{static_cast<float>(i), 0, 0, 1});
  const LinearTexels out = halved(in, false);
  ASSERT_EQ(out.texels.size(), 2U);
  EXPECT_FLOAT_EQ(out.texels[0][0], 0.5F);
  EXPECT_FLOAT_EQ(out.texels[1][0], 3);
}

TEST(BytesOf, RoundToTheNearest) {
  LinearTexels level{1, 1, {}};
  level.texels.push_back(LinearTexels::Texel{0.5F, 0.2F, 1.0F, 0.4F});
  const auto plain = bytes_of(level, false);
  EXPECT_EQ(plain, (std::vector<std::uint8_t>{128, 51, 255, 102}));
  EXPECT_EQ(bytes_of(level, false, 2)[3], 204);
  const auto coded = bytes_of(level, true);
  EXPECT_EQ(coded[0], 188);
  EXPECT_EQ(coded[3], 102);
}

}  // namespace
}  // namespace rigor::render
