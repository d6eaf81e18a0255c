// A fitted sensor model: its section is checked, and devices are drawn from its covariance.
#include "sensor-hal/models/calibration_section.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <cmath>
#include <filesystem>
#include <fstream>

#include "sensor-hal/models/camera_yaml.h"

namespace rigor {
namespace {

constexpr const char* kSensorModel = R"(
width_px: 640
height_px: 480
intrinsics: { fx_px: 500, fy_px: 500, cx_px: 320, cy_px: 240 }
calibration:
  version: 1
  kind: camera
  model: opencv0
  parameters:
    - { name: fx_px, value: 500, sigma: 2, path: intrinsics.fx_px }
    - { name: fy_px, value: 500, sigma: 2, path: intrinsics.fy_px }
    - { name: cx_mm, value: 32, sigma: 0, path: intrinsics.cx_px, scale: 10 }
  covariance: [4, 3.2, 4, 0, 0, 0]
  validity: { board_distance_m: [1, 3] }
  recordings: [{ file: left01.jpg, sha256: "00" }]
  not_identifiable: { k1: "one view" }
)";

std::string changed(const std::string& from, const std::string& to) {
  std::string s = kSensorModel;
  const auto at = s.find(from);
  EXPECT_NE(at, std::string::npos);
  return s.replace(at, from.size(), to);
}

Result<CameraSensorModel> parsed(const std::string& text) {
  auto root = ConfigDocument::parse(text, "model.yaml");
  EXPECT_TRUE(root);
  return parse_camera(*root);
}

TEST(CalibrationSection, AFittedSensorModelLoadsAsItStands) {
  const auto sensor_model = parsed(kSensorModel);
  ASSERT_TRUE(sensor_model) << sensor_model.error().text();
  EXPECT_EQ(sensor_model->model.fx_px, 500);
}

TEST(CalibrationSection, WhatIsWrongInItIsSaidWithItsPlace) {
  const auto few = parsed(changed("[4, 3.2, 4, 0, 0, 0]", "[4, 3.2, 4]"));
  ASSERT_FALSE(few);
  EXPECT_THAT(few.error().text(), testing::HasSubstr("model.yaml:13"));
  EXPECT_THAT(few.error().text(), testing::HasSubstr("6 numbers"));
  const auto negative = parsed(changed("[4, 3.2,", "[-4, 3.2,"));
  ASSERT_FALSE(negative);
  EXPECT_THAT(negative.error().text(), testing::HasSubstr("variance"));
  const auto unknown = parsed(changed("model: opencv0", "model: opencv0\n  modle: x"));
  ASSERT_FALSE(unknown);
}

class OnDisk : public testing::Test {
 protected:
  std::filesystem::path write(const std::string& text) {
    const auto file = std::filesystem::temp_directory_path() /
                      ("rigor-section-" + std::to_string(getpid()) + "-" +
                       testing::UnitTest::GetInstance()->current_test_info()->name() + ".yaml");
    std::ofstream(file) << text;
    file_ = file;
    return file;
  }
  void TearDown() override { std::filesystem::remove(file_); }
  std::filesystem::path file_;
};

TEST(CalibrationSection, DrawnDevicesHaveTheCovarianceOfTheFit) {
  const auto root = ConfigDocument::parse(kSensorModel, "model.yaml");
  ASSERT_TRUE(root);
  const CalibrationSection section = read_calibration(*root);
  double sum_x = 0, sum_xx = 0, sum_xy = 0;
  const int n = 2000;
  for (int i = 1; i <= n; ++i) {
    const auto drawn = draw_parameters(section, static_cast<std::uint64_t>(i));
    ASSERT_TRUE(drawn);
    ASSERT_EQ(drawn->size(), 3u);
    const double x = std::stod((*drawn)[0].value) - 500, y = std::stod((*drawn)[1].value) - 500;
    sum_x += x, sum_xx += x * x, sum_xy += x * y;
    EXPECT_EQ(std::stod((*drawn)[2].value), 320) << "no variance, and in the sensor model's unit";
  }
  // Standard errors: mean 2/√n, variance 4·√(2/n), covariance √((16 + 3.2²)/n).
  EXPECT_NEAR(sum_x / n, 0, 3.3 * 2 / std::sqrt(n));
  EXPECT_NEAR(sum_xx / n, 4, 3.3 * 4 * std::sqrt(2.0 / n));
  EXPECT_NEAR(sum_xy / n, 3.2, 3.3 * std::sqrt((16 + 3.2 * 3.2) / n));
}

TEST_F(OnDisk, TheSameNumberIsTheSameDevice) {
  const auto file = write(kSensorModel);
  EXPECT_EQ(load_camera(file, 7)->model.fx_px, load_camera(file, 7)->model.fx_px);
  EXPECT_NE(load_camera(file, 7)->model.fx_px, load_camera(file, 8)->model.fx_px);
  EXPECT_EQ(load_camera(file)->model.fx_px, 500);
}

TEST_F(OnDisk, WithoutACovarianceThereIsNothingToDrawFrom) {
  const auto plain = load_camera(write("width_px: 64\nheight_px: 48\nintrinsics: { fx_px: 50 }\n"), 3);
  ASSERT_FALSE(plain);
  EXPECT_THAT(plain.error().text(), testing::HasSubstr("rigor calibrate"));
}

TEST_F(OnDisk, AMatrixThatIsNoCovarianceIsRefused) {
  const auto bad = load_camera(write(changed("[4, 3.2, 4, 0, 0, 0]", "[4, 8, 4, 0, 0, 0]")), 3);
  ASSERT_FALSE(bad);
  EXPECT_THAT(bad.error().text(), testing::HasSubstr("positive semi-definite"));
}

}  // namespace
}  // namespace rigor
