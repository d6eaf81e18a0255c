// `rigor calibrate …` from recordings of simulated sensors, whose truth is known: answer, sensor model,
// report.
#include <cmath>
#include <opencv2/imgcodecs.hpp>
#include <random>

#include "sensor-hal/models/camera_yaml.h"
#include "sensor-hal/models/lidar/lidar_yaml.h"
#include "sensor-hal/models/tof/tof_yaml.h"
#include "tests/cli/calibrate_fixture.h"

namespace rigor::test {
namespace {

using nlohmann::json;
using ::testing::HasSubstr;

double value(const json& answer, const std::string& name) {
  return answer["parameters"][name]["value"].get<double>();
}

TEST_F(Calibrate, CameraFromARecording) {
  const json j = answer({"camera", CalibrationRecordings::get().board(), "--channel", "left/real", "--target",
                         kBoard, "-o", "left.yaml", "--report", "report"});
  expect_parameters(j, {"fx_px", "fy_px", "cx_px", "cy_px", "k1"});
  EXPECT_NEAR(value(j, "fx_px"), 465, 5);
  EXPECT_GT(j["rms_per_corner_px"].get<double>(), 0.005);
  EXPECT_LT(j["rms_per_corner_px"].get<double>(), 0.2);
  EXPECT_GE(j["models"].size(), 2u);
  expect_report("report", "Camera calibration");
  const auto sensor_model = load_camera(dir / "left.yaml");
  ASSERT_TRUE(sensor_model) << sensor_model.error().text();
  EXPECT_DOUBLE_EQ(sensor_model->model.fx_px, value(j, "fx_px"));
  EXPECT_EQ(sensor_model->model.width_px, 480);
  EXPECT_THAT(read_file(dir / "left.yaml"), HasSubstr("board.mcap"));
  EXPECT_FALSE(std::filesystem::exists(dir / "left.yaml.part"));
}

TEST_F(Calibrate, StereoFromARecording) {
  const json j =
      answer({"stereo", CalibrationRecordings::get().board(), "--channel", "left/real", "--right-channel",
              "right", "--target", kBoard, "--left-model", sensor("demo-camera"), "--right-model",
              sensor("demo-camera"), "-o", "stereo.yaml", "--report", "report"});
  expect_parameters(j, {"x_m", "y_m", "z_m"});
  EXPECT_NEAR(j["baseline_m"].get<double>(), 0.4, 0.004);
  expect_report("report", "Stereo calibration");
  EXPECT_THAT(read_file(dir / "stereo.yaml"), HasSubstr("T_left_right"));
}

TEST_F(Calibrate, ExtrinsicsFromARecording) {
  const json j =
      answer({"extrinsics", CalibrationRecordings::get().board(), "--camera", "left/real", "--camera-model",
              sensor("demo-camera"), "--second", "top", "--target", kBoard, "--rough", "0.2,0.22,0.02,0,-8,5",
              "--views", "8", "-o", "top.yaml", "--report", "report"});
  expect_parameters(j, {"x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad"});
  // Of the rig: the camera at (-0.2, -2.2, 1.5) looks at (0, 0, 1.2), the LiDAR stands at (0, -2.2, 1.3).
  const double truth[3] = {0.1992, 0.1957, 0.0449};
  for (std::size_t i = 0; i < 3; ++i) EXPECT_NEAR(j["position_m"][i].get<double>(), truth[i], 0.06) << i;
  expect_report("report", "Where the second sensor sits");
  const std::string yaml = read_file(dir / "top.yaml");
  for (const char* part : {"quaternion_wxyz", "camera: left/real", "lidar: top", "T_camera_lidar:"})
    EXPECT_THAT(yaml, HasSubstr(part));
}

TEST_F(Calibrate, DelayFromARecording) {
  const json j = answer({"delay", CalibrationRecordings::get().board(), "--first", "turntable:0", "--second",
                         "left/real", "--target", kBoard, "--camera-model", sensor("demo-camera"), "-o",
                         "delay.yaml", "--report", "report"});
  expect_parameters(j, {"delay_s", "gain", "offset"});
  EXPECT_NEAR(value(j, "delay_s"), 0, 0.001);
  EXPECT_NEAR(value(j, "gain"), M_PI / 180, 1e-4);  // degrees to radians
  expect_report("report", "Time between two channels");
}

TEST_F(Calibrate, TwinFromARecordingOfAPair) {
  const json j = answer({"twin", CalibrationRecordings::get().board(), "--channel", "left", "-o", "twin.yaml",
                         "--report", "report"});
  expect_parameters(j, {"bias_dn", "real_noise_dn", "simulated_noise_dn", "noise_ratio"});
  // Both are drawn from one model.
  EXPECT_NEAR(value(j, "bias_dn"), 0, 0.1);
  EXPECT_NEAR(value(j, "noise_ratio"), 1, 0.05);
  expect_report("report", "A channel and its twin");
}

TEST_F(Calibrate, LidarFromARecording) {
  const json j = answer({"lidar", CalibrationRecordings::get().board(), "--channel", "top", "--base",
                         sensor("velodyne-vlp16"), "-o", "top.yaml", "--report", "report"});
  ASSERT_FALSE(j["parameters"].empty());
  EXPECT_GE(j["models"].size(), 2u);
  expect_report("report", "LiDAR calibration");
  const auto sensor_model = load_lidar_model(dir / "top.yaml");
  ASSERT_TRUE(sensor_model) << sensor_model.error().text();
  // The scans were drawn from the base, whose beams have no biases: nothing that is fitted predicts better,
  // and beams stay where they are.
  EXPECT_GE(j["scans"].get<int>(), 20);
  EXPECT_NEAR(j["held_out_rms_m"].get<double>(), j["held_out_uncorrected_rms_m"].get<double>(), 5e-4);
  const auto base = load_lidar_model(sensor("velodyne-vlp16"));
  ASSERT_TRUE(base);
  ASSERT_EQ(sensor_model->scan.beams.size(), 16u);
  for (std::size_t i = 0; i < 16; ++i)
    EXPECT_NEAR(sensor_model->scan.beams[i].elevation_rad, base->scan.beams[i].elevation_rad, 1e-3) << i;
  // Its noise is 6.33 mm over remission + 0.172: 30.9 mm at the darkest that is there, 0.033, and 7.7 mm at
  // 0.65.
  EXPECT_GT(j["shot_sigma_m"].get<double>(), 0.0077);
  EXPECT_LT(j["shot_sigma_m"].get<double>(), 0.0309);
}

TEST_F(Calibrate, TofFromARecording) {
  const json j = answer({"tof", CalibrationRecordings::get().wall(), "--base", sensor("sr4000"), "-o",
                         "tof.yaml", "--report", "report"});
  expect_parameters(j, {"contrast"});
  EXPECT_GE(j["noise"]["laws"].size(), 2u);
  expect_report("report", "Time-of-flight calibration");
  const auto sensor_model = load_tof_model(dir / "tof.yaml");
  ASSERT_TRUE(sensor_model) << sensor_model.error().text();
}

/// Pictures of an even light by EMVA's equations: gain 0.05 DN/e, 6 e read noise, black at 32 DN, 12 bits.
void write_flats(const std::filesystem::path& folder) {
  std::filesystem::create_directories(folder);
  std::mt19937 random(1);
  std::normal_distribution<double> normal;
  const auto picture = [&](const std::string& name, double electrons) {
    cv::Mat m(96, 96, CV_16UC1);
    for (auto it = m.begin<std::uint16_t>(); it != m.end<std::uint16_t>(); ++it) {
      const double e = electrons + std::sqrt(electrons + 36) * normal(random);
      *it = static_cast<std::uint16_t>(std::clamp(std::round(32 + 0.05 * e), 0.0, 4095.0));
    }
    cv::imwrite((folder / name).string(), m);
  };
  for (const int ms : {2, 5, 10, 15, 20, 25, 30, 35, 40, 45, 50, 55})
    for (int i = 0; i < 2; ++i)
      picture("flat_" + std::to_string(ms) + "ms_" + std::to_string(i) + ".png", 1800.0 * ms);
  for (const int ms : {2, 20, 55})
    for (int i = 0; i < 2; ++i) picture("dark_" + std::to_string(ms) + "ms_" + std::to_string(i) + ".png", 5);
}

TEST_F(Calibrate, PhotonFromPictures) {
  write_flats(dir / "flats");
  const json j = answer({"photon", "flats", "--bits", "12", "--base", sensor("demo-camera"), "-o",
                         "camera.yaml", "--report", "report"});
  ASSERT_FALSE(j["parameters"].empty());
  expect_report("report", "Photon transfer");
  const auto sensor_model = load_camera(dir / "camera.yaml");
  ASSERT_TRUE(sensor_model) << sensor_model.error().text();
}

TEST_F(Calibrate, ShadingFromPictures) {
  std::filesystem::create_directories(dir / "flats");
  std::mt19937 random(2);
  std::normal_distribution<double> normal;
  for (int i = 0; i < 2; ++i) {
    cv::Mat m(360, 480, CV_8UC1);
    for (int v = 0; v < m.rows; ++v)
      for (int u = 0; u < m.cols; ++u) {
        const double r2 = (std::pow(u - 241.6, 2) + std::pow(v - 178.5, 2)) / (465.0 * 465.0);
        const double light = 200 / std::pow(1 + r2, 2);  // cos^4
        m.at<std::uint8_t>(v, u) = static_cast<std::uint8_t>(std::round(light + normal(random)));
      }
    cv::imwrite((dir / "flats" / ("flat_10ms_" + std::to_string(i) + ".png")).string(), m);
  }
  const json j = answer({"shading", "flats", "--black", "0", "--base", sensor("demo-camera"), "-o",
                         "camera.yaml", "--report", "report"});
  ASSERT_FALSE(j["parameters"].empty());
  EXPECT_GE(j["models"].size(), 2u);
  const auto sensor_model = load_camera(dir / "camera.yaml");
  ASSERT_TRUE(sensor_model) << sensor_model.error().text();
}

TEST_F(Calibrate, HelpHasAnExampleForEachAndNothingIsWrittenOver) {
  for (const char* x :
       {"camera", "stereo", "photon", "shading", "lidar", "tof", "extrinsics", "delay", "twin"}) {
    const Said said = run({x, "--help"});
    EXPECT_EQ(said.status, 0);
    EXPECT_THAT(said.out, HasSubstr(std::string("rigor calibrate ") + x));
  }
  write_file(dir / "left.yaml", "mine");
  expect_refused({"twin", CalibrationRecordings::get().board(), "--channel", "left", "-o", "left.yaml"},
                 {"left.yaml", "--force"});
  EXPECT_EQ(read_file(dir / "left.yaml"), "mine");
}

}  // namespace
}  // namespace rigor::test
