#include "calibration/core/fit_output.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>

#include "sensor-hal/models/calibration_section.h"
#include "sensor-hal/models/camera_yaml.h"

namespace rigor::calibration {
namespace {

FitResult small_fit() {
  FitResult fit;
  fit.model = "opencv0";
  fit.parameters = {{"fx_px", 533.1234567890123, 0.4, 1},
                    {"cx_px", 320.5, 0.1, 1},
                    {"k9", 1, std::numeric_limits<double>::infinity(), 1}};
  fit.covariance = Eigen::MatrixXd::Zero(3, 3);
  fit.covariance(0, 0) = 0.16;
  fit.covariance(0, 1) = fit.covariance(1, 0) = 0.01;
  fit.covariance(1, 1) = 0.01;
  fit.covariance(2, 2) = std::numeric_limits<double>::infinity();
  fit.residuals = {"px", 100, 2, 0.2, 0.1, 0.4, 0.9};
  fit.rejected = {{"left01.jpg corner (3, 4)", 2.5, 12}};
  fit.validity = {{"board_distance_m", 0.5, 3}};
  fit.not_identifiable = {{"read_noise_e", "all dark pixels are clipped: \"0\""}};
  fit.warnings = {"few views: take more"};
  return fit;
}

TEST(FitOutput, ASensorModelReadsBackToTheLastDigitWithItsCovariance) {
  SensorModelRecipe recipe;
  recipe.kind = "camera";
  recipe.base = "width_px: 640\nheight_px: 480\nintrinsics: { fx_px: 1, cy_px: 7 }\nlens: { k1: 0.5 }\n";
  recipe.set = {{"intrinsics.fx_px", exact_text(533.1234567890123)}, {"intrinsics.cx_px", "320.5"}};
  recipe.remove = {"lens"};
  recipe.places = {{"fx_px", "intrinsics.fx_px", 1}, {"cx_px", "intrinsics.cx_px", 1}};
  const auto text = sensor_model_yaml(recipe, small_fit(), {{"left01.jpg", "abc"}});
  ASSERT_TRUE(text) << text.error().text();
  const auto root = ConfigDocument::parse(*text, "fitted.yaml");
  ASSERT_TRUE(root) << root.error().text();
  const auto sensor_model = parse_camera(*root);
  ASSERT_TRUE(sensor_model) << sensor_model.error().text() << "\n" << *text;
  EXPECT_EQ(sensor_model->model.fx_px, 533.1234567890123);
  EXPECT_EQ(sensor_model->model.cy_px, 7) << "what was not fitted stays";
  EXPECT_EQ(sensor_model->model.lens.k1, 0) << "what was removed is gone";
  const CalibrationSection s = read_calibration(*root);
  ASSERT_EQ(s.parameters.size(), 2u);
  EXPECT_EQ(s.covariance_of(0, 1), 0.01);
  EXPECT_EQ(s.parameters[0].path, "intrinsics.fx_px");
  EXPECT_EQ(s.recordings[0].sha256, "abc");
  EXPECT_TRUE(s.not_identifiable.count("k9"));
  EXPECT_TRUE(s.not_identifiable.count("read_noise_e"));
  EXPECT_EQ(s.warnings.at(0), "few views: take more");
  EXPECT_EQ(s.validity.at("board_distance_m")[1], 3);
}

TEST(FitOutput, JsonHasNoNumberForWhatTheDataDoNotSay) {
  const auto j = to_json(small_fit());
  EXPECT_EQ(j["parameters"]["fx_px"]["value"], 533.1234567890123);
  EXPECT_EQ(j["parameters"]["fx_px"]["sigma"], 0.4);
  EXPECT_TRUE(j["parameters"]["k9"]["sigma"].is_null());
  EXPECT_EQ(j["rejected"][0]["what"], "left01.jpg corner (3, 4)");
  EXPECT_TRUE(j["not_identifiable"].contains("read_noise_e"));
}

TEST(FitOutput, ABaseThatIsNoSensorModelIsRefused) {
  SensorModelRecipe recipe;
  recipe.base = "[1, 2]";
  EXPECT_FALSE(sensor_model_yaml(recipe, small_fit(), {}));
  recipe.base = "intrinsics: 5\n";
  recipe.set = {{"intrinsics.fx_px", "1"}};
  const auto through = sensor_model_yaml(recipe, small_fit(), {});
  ASSERT_FALSE(through);
  EXPECT_THAT(through.error().text(), testing::HasSubstr("intrinsics.fx_px"));
}

}  // namespace
}  // namespace rigor::calibration
