#include "sim/nature/trees/allometry.h"
#include "tests/paths.h"

#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>

namespace rigor::nature {
namespace {

TEST(Allometry, KnowsEveryCodeOfTheMappedStands) {
  const std::filesystem::path file = rigor::test::test_data("forest_stands/trees.csv");
  if (!std::filesystem::exists(file)) GTEST_SKIP() << "no test data: " << file;
  std::ifstream in(file);
  std::string line;
  std::getline(in, line);
  std::size_t trees = 0;
  while (std::getline(in, line)) {
    std::istringstream cells(line);
    std::string stand, id, species;
    std::getline(cells, stand, ',');
    std::getline(cells, id, ',');
    std::getline(cells, species, ',');
    ++trees;
    EXPECT_TRUE(find_species(species).known) << species;
  }
  EXPECT_EQ(trees, 5686u);
}

TEST(Allometry, GrowsWithDiameterAndStaysFiniteAndBounded) {
  for (const Species& s : all_species()) {
    TreeSize last{};
    for (double dbh_m = 0.001; dbh_m < 13; dbh_m *= 1.05) {
      const TreeSize t = size_of(s, {.dbh_m = dbh_m});
      for (const double v : {t.dbh_m, t.height_m, t.crown_radius_m, t.crown_base_m})
        ASSERT_TRUE(std::isfinite(v)) << s.code;
      EXPECT_GE(t.height_m, last.height_m) << s.code << " " << dbh_m;
      EXPECT_GE(t.crown_radius_m, last.crown_radius_m) << s.code << " " << dbh_m;
      EXPECT_GE(t.crown_base_m, last.crown_base_m - 1e-12) << s.code << " " << dbh_m;
      EXPECT_LT(t.crown_base_m, t.height_m);
      EXPECT_LE(t.height_m, s.height_limit_m) << s.code;
      EXPECT_GT(t.crown_radius_m, 0);
      EXPECT_LT(t.crown_radius_m, 25) << s.code;
      last = t;
    }
    EXPECT_FALSE(s.source.empty()) << s.code;
  }
}

TEST(Allometry, SpeciesAreSortedAndCodesOccurOnce) {
  const auto all = all_species();
  for (std::size_t i = 1; i < all.size(); ++i) EXPECT_LT(all[i - 1].code, all[i].code);
}

// Heights of trees that are on record: the curve is a mean over sites, records stand on the best ones.
TEST(Allometry, AgreesWithKnownTrees) {
  const auto height = [](const char* code, double dbh_m) {
    return height_from_dbh(*find_species(code).species, dbh_m);
  };
  // Old-growth Douglas-fir of the western Cascades: 1.5 m thick and 60–75 m high (Franklin et al. 1981).
  EXPECT_GT(height("PSME", 1.5), 55);
  EXPECT_LT(height("PSME", 1.5), 78);
  // Western hemlock there: 0.9–1.2 m and 50–65 m (Franklin and Dyrness 1988, table of old-growth sizes).
  EXPECT_GT(height("TSHE", 1.05), 45);
  EXPECT_LT(height("TSHE", 1.05), 66);
  // Pacific silver fir: 0.9–1.1 m and 44–55 m (same).
  EXPECT_GT(height("ABAM", 1.0), 42);
  EXPECT_LT(height("ABAM", 1.0), 56);
  // Mountain hemlock: 0.75–1.0 m and 35 m and more (same).
  EXPECT_GT(height("TSME", 0.85), 30);
  EXPECT_LT(height("TSME", 0.85), 45);
  // Norway spruce, 40 cm: yield tables 26–34 m.
  EXPECT_GT(height("Picea", 0.40), 25);
  EXPECT_LT(height("Picea", 0.40), 35);
  // A giant of 3 m is believable: no higher than the highest Douglas-fir standing (about 100 m).
  EXPECT_GT(height("PSME", 3.0), 70);
  EXPECT_LT(height("PSME", 3.0), 100);
  EXPECT_LT(height("THPL", 3.0), 72);
}

TEST(Allometry, KnowsTheShortCodesOfEuropeanLists) {
  for (const auto& [code, genus] : {std::pair{"PIAB", "Picea"}, {"FASY", "Fagus"}, {"acps", "Acer"}}) {
    const auto match = find_species(code);
    EXPECT_TRUE(match.known) << code;
    EXPECT_EQ(match.species->code, genus);
  }
}

TEST(Allometry, FindsGenusSubspeciesNumbersAndGenericKinds) {
  EXPECT_EQ(find_species("tshe").species->code, "TSHE");
  EXPECT_EQ(find_species("Picea abies").species->code, "Picea");
  EXPECT_EQ(find_species("CANO9").species->code, "CANO");
  EXPECT_TRUE(find_species("CANO9").known);
  for (const char* unknown : {"", "XXXX", " ", "Quercus2", "zzzzzzzzzzzzzzzzzz"}) {
    EXPECT_FALSE(find_species(unknown).known) << unknown;
    EXPECT_TRUE(is_conifer(find_species(unknown).species->form)) << unknown;
  }
  EXPECT_FALSE(find_species("QUZZ").known);
  EXPECT_FALSE(is_conifer(find_species("QUZZ").species->form));
}

TEST(Allometry, MeasuresGoBeforeCurvesAndNonsenseDoesNotPass) {
  const Species& s = *find_species("TSHE").species;
  const TreeSize given = size_of(s, {.dbh_m = 0.5, .height_m = 21, .crown_radius_m = 6, .crown_base_m = 4});
  EXPECT_DOUBLE_EQ(given.height_m, 21);
  EXPECT_DOUBLE_EQ(given.crown_radius_m, 6);
  EXPECT_DOUBLE_EQ(given.crown_base_m, 4);
  EXPECT_LT(size_of(s, {.dbh_m = 0.5, .height_m = 10, .crown_base_m = 30}).crown_base_m, 10);
  EXPECT_TRUE(size_of(s, {}).seedling);
  EXPECT_TRUE(size_of(s, {.dbh_m = NAN, .height_m = NAN}).seedling);
  EXPECT_TRUE(size_of(s, {.dbh_m = -1}).seedling);
  const double inf = std::numeric_limits<double>::infinity();
  const TreeSize wild =
      size_of(s, {.dbh_m = inf, .height_m = -inf, .crown_radius_m = NAN, .crown_base_m = inf});
  EXPECT_TRUE(std::isfinite(wild.height_m) && std::isfinite(wild.crown_radius_m) &&
              std::isfinite(wild.crown_base_m));
  // Only the height is known: the diameter is the one that has it.
  const TreeSize by_height = size_of(s, {.height_m = 30});
  EXPECT_FALSE(by_height.seedling);
  EXPECT_NEAR(height_from_dbh(s, by_height.dbh_m), 30, 0.01);
}

}  // namespace
}  // namespace rigor::nature
