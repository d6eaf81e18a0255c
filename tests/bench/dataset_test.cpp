// Parts of datasets that need no world: masks, values, arrays.
#include <gmock/gmock.h>

#include <cmath>
#include <cstring>
#include <numeric>

#include "bench/dataset/coco_rle.h"
#include "bench/dataset/npy.h"
#include "bench/dataset/variation.h"

namespace rigor::test {
namespace {

using dataset::draw_conditions;
using dataset::Values;
using dataset::Variation;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

TEST(CocoRle, IsWhatPycocotoolsWrites) {
  // pycocotools.mask.encode of a 3 x 4 picture whose middle column's lower two pixels are set: runs 4 2 6,
  // "426".
  const std::vector<std::uint16_t> ids{0, 0, 0, 0,  //
                                       0, 1, 0, 0,  //
                                       0, 1, 0, 0};
  const auto runs = coco::runs_of(ids, 4, 3, 1);
  ASSERT_EQ(runs.size(), 1u);
  EXPECT_THAT(runs[0], ElementsAre(4, 2, 6));
  EXPECT_EQ(coco::compress(runs[0]), "426");
  // Lengths beyond four bits, and differences below zero from the fourth on.
  EXPECT_EQ(coco::compress(std::vector<std::uint32_t>{0, 100, 3, 90, 40}), "0T33FU1")
      << "0, 100 in two characters, 3, and as differences 90 - 100 and 40 - 3";
}

TEST(CocoRle, BeginsWithAnEmptyRunWhereTheFirstPixelIsIn) {
  const std::vector<std::uint16_t> ids{2, 1, 2, 1};
  const auto runs = coco::runs_of(ids, 2, 2, 3);
  EXPECT_THAT(runs[0], ElementsAre(2, 2)) << "the right column";
  EXPECT_THAT(runs[1], ElementsAre(0, 2, 2)) << "the left one";
  EXPECT_THAT(runs[2], ElementsAre(4)) << "not in the picture";
}

TEST(DatasetValues, AreWordsOrNumbersBetweenTwo) {
  const auto words = Values::parse({"clear, fog", "here"});
  ASSERT_TRUE(words) << words.error().text();
  EXPECT_EQ(words->at(0.1), "clear");
  EXPECT_EQ(words->at(0.9), "fog");
  EXPECT_EQ(words->at(1), "fog");
  const auto range = Values::parse({"50..500", "here"});
  ASSERT_TRUE(range);
  EXPECT_EQ(range->at(0), "50");
  EXPECT_EQ(range->at(0.5), "275");
  EXPECT_EQ(Values::parse({"log:50..5000", "here"})->at(0.5), "500");
  EXPECT_EQ(Values::parse({"-1e-3..2", "here"})->at(0), "-0.001");
}

TEST(DatasetValues, ThatAreNoneSayWhere) {
  for (const char* text : {"5..1", "log:0..1", "1..x", "a,,b", "", "log:3", "nan..1", "..", "1..2..3"}) {
    const auto values = Values::parse({text, "data.yaml:7:3: vary.x"});
    ASSERT_FALSE(values) << text;
    EXPECT_EQ(values.error().where, "data.yaml:7:3: vary.x");
    EXPECT_THAT(values.error().message, HasSubstr("expected")) << text;
  }
}

std::vector<Variation> variations(const std::vector<std::pair<std::string, std::string>>& given) {
  std::vector<Variation> out;
  for (const auto& [key, values] : given) out.push_back(*Variation::parse(key, {values, "here"}));
  return out;
}

TEST(DatasetConditions, DependOnSeedKeyAndIndexAlone) {
  const auto one = variations({{"joint.table", "0..360"}});
  const auto more = variations({{"Tree.dbh_m", "0.1..1"}, {"joint.table", "0..360"}});
  std::vector<double> values;
  for (std::uint64_t k = 0; k < 400; ++k) {
    EXPECT_EQ(draw_conditions(one, 7, k)[0], draw_conditions(more, 7, k)[1]);
    values.push_back(std::stod(draw_conditions(one, 7, k)[0].second));
  }
  EXPECT_NE(draw_conditions(one, 7, 3), draw_conditions(one, 8, 3));
  EXPECT_NE(draw_conditions(one, 7, 3), draw_conditions(one, 7, 4));
  // The mean of 400 even draws lies within 4 standard deviations of 104/√400.
  EXPECT_NEAR(std::accumulate(values.begin(), values.end(), 0.0) / 400, 180, 4 * 104.0 / 20);
}

TEST(DatasetConditions, RefineAPresetOnlyWhereItHasThatWeather) {
  const auto v =
      variations({{"simulation.weather", "clear,fog"}, {"Atmosphere.fog_visibility_m", "50..500"}});
  int fog = 0;
  for (std::uint64_t k = 0; k < 50; ++k) {
    const auto c = draw_conditions(v, 1, k);
    fog += c[0].second == "fog";
    EXPECT_EQ(c[1].second.empty(), c[0].second == "clear") << k;
  }
  EXPECT_GT(fog, 10);
  EXPECT_LT(fog, 40);
}

TEST(DatasetVariation, RefusesKeysAndValuesThatDoNotFit) {
  for (const auto& [key, values] :
       std::vector<std::pair<std::string, std::string>>{{"simulation.weather", "hail"},
                                                        {"simulation.weather", "0..1"},
                                                        {"weather", "clear"},
                                                        {"joint.a", "left,right"},
                                                        {"channels.left.sensor", "1"},
                                                        {"channels.left", "1"},
                                                        {"channels.left.exposure_us", "0..100"},
                                                        {"channels.left.exposure_us", "100..1e9"},
                                                        {"channels.left.gain_db", "0,90"},
                                                        {"atmosphere.wetness", "0..1"}}) {
    const auto v = Variation::parse(key, {values, "--vary " + key});
    ASSERT_FALSE(v) << key;
    EXPECT_EQ(v.error().where, "--vary " + key);
  }
}

TEST(Npy, HasItsDataAtAMultipleOf64Bytes) {
  const std::vector<float> values{1, 2, 3};
  const std::string file = npy::floats(values, {3});
  EXPECT_EQ(file.substr(0, 8), std::string("\x93NUMPY\x01\x00", 8));
  const std::size_t length = static_cast<unsigned char>(file[8]) + 256U * static_cast<unsigned char>(file[9]);
  EXPECT_EQ((10 + length) % 64, 0u);
  EXPECT_EQ(file.size(), 10 + length + 12);
  EXPECT_THAT(file.substr(10, length),
              HasSubstr("{'descr': '<f4', 'fortran_order': False, 'shape': (3,), }"));
  EXPECT_EQ(file[10 + length - 1], '\n');
  EXPECT_EQ(std::memcmp(file.data() + 10 + length, values.data(), 12), 0);
}

}  // namespace
}  // namespace rigor::test
