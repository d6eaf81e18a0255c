// Camera sensor models: every key reaches its field, every mistake names its place, and the sensor models
// that come along load.
#include "sensor-hal/models/camera_yaml.h"
#include "tests/paths.h"

#include <gtest/gtest.h>

#include <filesystem>
#include <set>
#include <string>

namespace rigor {
namespace {

Result<CameraSensorModel> parse(const std::string& text) {
  auto root = ConfigDocument::parse(text, "camera.yaml");
  if (!root) return tl::unexpected<Error>(root.error());
  return parse_camera(*root);
}

constexpr const char* kBase = "width_px: 640\nheight_px: 480\nintrinsics: { fx_px: 500 }\n";

TEST(CameraSensorModel, EveryEffectHasItsKeys) {
  const auto sensor_model = parse(std::string(kBase) + R"(
projection: kannala_brandt
fisheye: { k1: 0.01, k2: 0.02, k3: 0.03, k4: 0.04 }
chromatic: { magnification: [1.001, 1, 0.999], focus_shift_mm: [10, 0, -10] }
depth_of_field: { focus_distance_m: 2.5, focal_length_mm: 8 }
shutter: { line_time_us: 18.9, motion_blur: true }
bloom: { fraction: 0.02, radius_px: 3, exponent: 1.2, veiling_glare: 0.01 }
processing: { median_filter: true, white_balance: [1.8, 1, 1.5], demosaic: true, gamma: 2.2, subtract_black: true }
noise: { temperature_c: 40, dark_reference_c: 20, dark_doubling_k: 6, hot_pixel_share: 0.001, hot_pixel_dark_e_per_s: 800, response_c2: -0.04, response_c3: 0.01 }
)");
  ASSERT_TRUE(sensor_model) << sensor_model.error().text();
  const CameraModel& m = sensor_model->model;
  EXPECT_EQ(m.projection, Projection::kannala_brandt);
  EXPECT_EQ(m.fisheye, (KannalaBrandtLens{0.01, 0.02, 0.03, 0.04}));
  EXPECT_EQ(m.chromatic.magnification, (std::array<double, 3>{1.001, 1, 0.999}));
  EXPECT_NEAR(m.chromatic.focus_shift_m[0], 0.01, 1e-15);
  EXPECT_NEAR(m.chromatic.focus_shift_m[2], -0.01, 1e-15);
  EXPECT_EQ(m.depth_of_field.focus_distance_m, 2.5);
  EXPECT_NEAR(m.depth_of_field.focal_length_m, 0.008, 1e-15);
  EXPECT_NEAR(m.shutter.line_time_s, 18.9e-6, 1e-18);
  EXPECT_TRUE(m.shutter.motion_blur);
  EXPECT_EQ(m.bloom.fraction, 0.02);
  EXPECT_EQ(m.bloom.radius_px, 3);
  EXPECT_EQ(m.bloom.exponent, 1.2);
  EXPECT_EQ(m.bloom.veiling_glare, 0.01);
  EXPECT_TRUE(m.processing.median_filter);
  EXPECT_TRUE(m.processing.demosaic);
  EXPECT_TRUE(m.processing.subtract_black);
  EXPECT_EQ(m.processing.gamma, 2.2);
  EXPECT_EQ(m.processing.white_balance, (std::array<double, 3>{1.8, 1, 1.5}));
  EXPECT_EQ(m.noise.temperature_c, 40);
  EXPECT_EQ(m.noise.dark_reference_c, 20);
  EXPECT_EQ(m.noise.dark_doubling_k, 6);
  EXPECT_EQ(m.noise.hot_pixel_share, 0.001);
  EXPECT_EQ(m.noise.hot_pixel_dark_e_per_s, 800);
  EXPECT_EQ(m.noise.response_c2, -0.04);
  EXPECT_EQ(m.noise.response_c3, 0.01);
}

TEST(CameraSensorModel, NamesThePlaceOfEveryMistake) {
  struct Case {
    const char* line;
    const char* named;
  };
  for (const Case& c :
       {Case{"fisheye: { k1: 0.1 }", "projection: kannala_brandt"},
        Case{"projection: kannala_brandt\nlens: { k1: 0.1 }", "fisheye"},
        Case{"projection: equidistant", "kannala_brandt"}, Case{"bloom: { fraction: 1.5 }", "bloom.fraction"},
        Case{"bloom: { fraction: 0.6, veiling_glare: 0.6 }", "veiling_glare"},
        Case{"bloom: { radius: 3 }", "radius_px"},
        Case{"chromatic: { magnification: [1, 1] }", "magnification"},
        Case{"depth_of_field: { focus_distance_m: 0.001 }", "focus_distance_m"},
        Case{"shutter: { line_time_us: -1 }", "line_time_us"}, Case{"processing: { gamma: 0 }", "gamma"},
        Case{"noise: { hot_pixel_share: 2 }", "hot_pixel_share"},
        Case{"noise: { dark_doubling_k: 0 }", "dark_doubling_k"},
        Case{"noise: { response_c2: -0.6 }", "response that rises"}}) {
    const auto sensor_model = parse(std::string(kBase) + c.line);
    ASSERT_FALSE(sensor_model) << c.line;
    EXPECT_EQ(sensor_model.error().code, ErrorCode::bad_input);
    EXPECT_NE(sensor_model.error().text().find("camera.yaml"), std::string::npos)
        << sensor_model.error().text();
    EXPECT_NE(sensor_model.error().text().find(c.named), std::string::npos) << sensor_model.error().text();
  }
}

TEST(CameraSensorModel, ThoseThatComeAlongLoad) {
  const std::set<std::string> cameras{"demo-camera", "industrial-global-shutter", "rolling-shutter-phone",
                                      "fisheye-190", "stereo-module-left",        "stereo-module-right"};
  for (const std::string& name : cameras) {
    const auto sensor_model = load_camera((rigor::test::source_dir() + "/configs/sensors/") + name + ".yaml");
    ASSERT_TRUE(sensor_model) << sensor_model.error().text();
    const CameraModel& m = sensor_model->model;
    // The middle of the picture is in it, and so is at least one corner's light or the fisheye's circle.
    EXPECT_TRUE(unproject_ray(m, {m.cx_px, m.cy_px})) << name;
    EXPECT_GT(sensor_model->exposure_s, 0) << name;
    for (const double u : {0.0, 0.5, 1.0}) {
      const bool reached = unproject_ray(m, {u * (m.width_px - 1), m.cy_px}).has_value();
      EXPECT_TRUE(reached) << name << " at " << u;
    }
  }
}

TEST(CameraSensorModel, TheModuleIsAPairOfOneKind) {
  const auto left = load_camera(rigor::test::source_dir() + "/configs/sensors/stereo-module-left.yaml");
  const auto right = load_camera(rigor::test::source_dir() + "/configs/sensors/stereo-module-right.yaml");
  ASSERT_TRUE(left && right);
  EXPECT_EQ(left->model.width_px, right->model.width_px);
  EXPECT_EQ(left->model.noise.adc_bits, right->model.noise.adc_bits);
  EXPECT_EQ(left->exposure_s, right->exposure_s) << "one trigger, one exposure";
  EXPECT_NE(left->model.fx_px, right->model.fx_px) << "no two lenses are the same";
}

}  // namespace
}  // namespace rigor
