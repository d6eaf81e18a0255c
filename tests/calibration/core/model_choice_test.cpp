#include "calibration/core/model_choice.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

namespace rigor::calibration {
namespace {

constexpr double kNone = std::numeric_limits<double>::quiet_NaN();

TEST(ModelChoice, TheSmallestModelThatPredictsAsWellIsChosenAgainstTheBic) {
  std::vector<Candidate> c{
      {.name = "2", .parameters = 2, .bic = 10, .cross_validation = 9, .cross_validation_sigma = 1},
      {.name = "4", .parameters = 4, .bic = 6, .cross_validation = 5.5, .cross_validation_sigma = 1},
      {.name = "5", .parameters = 5, .bic = 5, .cross_validation = 5, .cross_validation_sigma = 1}};
  EXPECT_EQ(choose_model(c), 1u);
  EXPECT_TRUE(c[1].chosen);
  EXPECT_FALSE(c[2].chosen);
  EXPECT_NE(c[2].note.find("least BIC"), std::string::npos);
  EXPECT_NE(c[0].note.find("predicts worse"), std::string::npos);
}

TEST(ModelChoice, WithoutCrossValidationTheLeastBicDecides) {
  std::vector<Candidate> c{{.name = "a", .parameters = 1, .bic = 3, .cross_validation = kNone},
                           {.name = "b", .parameters = 2, .bic = 2, .cross_validation = kNone},
                           {.name = "c", .parameters = 3, .bic = 4, .cross_validation = kNone}};
  EXPECT_EQ(choose_model(c), 1u);
}

TEST(ModelChoice, BicPenalisesAParameterByTheLogarithmOfTheData) {
  EXPECT_NEAR(bic(100, 100, 3) - bic(100, 100, 2), std::log(100.0), 1e-12);
  EXPECT_NEAR(bic(200, 100, 2) - bic(100, 100, 2), 100 * std::log(2.0), 1e-9);
  EXPECT_TRUE(std::isfinite(bic(0, 10, 2)));
}

}  // namespace
}  // namespace rigor::calibration
