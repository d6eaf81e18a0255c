// The calibrations called as functions give what the command prints and writes, and print nothing.
#include <functional>

#include "bench/console/progress.h"
#include "calibration/procedures/calibration_report.h"
#include "calibration/procedures/camera_calibration.h"
#include "calibration/procedures/delay_calibration.h"
#include "calibration/procedures/extrinsics_calibration.h"
#include "calibration/procedures/lidar_calibration.h"
#include "calibration/procedures/photon_calibration.h"
#include "calibration/procedures/stereo_calibration.h"
#include "calibration/procedures/tof_calibration.h"
#include "calibration/procedures/twin_calibration.h"
#include "tests/cli/calibrate_fixture.h"

namespace rigor::test {
namespace {

using nlohmann::json;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

class CalibrationLibrary : public Calibrate {
 protected:
  void SetUp() override { set_progress_format(ProgressFormat::none); }

  /// The command with these words, and the function, over the same inputs. `exact`: a fit that gives the same
  /// bits each time; else what is compared has as many digits as the uncertainty leaves meaning to.
  void expect_same(const std::vector<std::string>& words,
                   const std::function<Result<CalibrationResult>()>& calibrate, bool exact = true) {
    SCOPED_TRACE(words.front());
    ::testing::internal::CaptureStdout();
    ::testing::internal::CaptureStderr();
    const auto result = calibrate();
    EXPECT_THAT(::testing::internal::GetCapturedStdout(), IsEmpty());
    EXPECT_THAT(::testing::internal::GetCapturedStderr(), IsEmpty());
    ASSERT_TRUE(result) << result.error().text();
    const std::string name = words.front() + ".yaml", by_function = words.front() + "-by-function.yaml";
    std::vector<std::string> all = words;
    all.insert(all.end(), {"-o", name});
    json said = answer(all);
    // Where the command wrote is its own; all other numbers are the function's.
    const auto saved = save_sensor_model(*result, dir / by_function);
    ASSERT_TRUE(saved) << saved.error().text();
    ASSERT_EQ(saved->size(), result->parts.size() + 1);
    for (const SavedSensorModel& model : *saved) {
      const std::string key = model.part.empty() ? "output" : model.part + "_output";
      ASSERT_TRUE(said.contains(key)) << said.dump();
      const std::string file = said[key].get<std::string>();
      if (exact) {
        EXPECT_EQ(read_file(dir / file), read_file(model.file)) << file;
      }
      EXPECT_THAT(read_file(model.file), HasSubstr("calibration:"));
      said.erase(key);
    }
    const json returned = json::parse(result_json(*result).dump());
    EXPECT_EQ(said.flatten().size(), returned.flatten().size());
    if (exact) {
      EXPECT_EQ(said, returned);
    }
    // What a program asks for first.
    const auto n = static_cast<Eigen::Index>(result->fit.parameters.size());
    EXPECT_EQ(result->fit.covariance.rows(), n);
    EXPECT_FALSE(result->figures.empty());
    EXPECT_THAT(html_report(*result), HasSubstr("<title>" + result->title));
    all.erase(all.end() - 2, all.end());
    EXPECT_EQ(run(all).out, text_report(*result));
  }
  template <class Options>
  static Options of(const std::filesystem::path& input, const std::string& channel = {},
                    const std::filesystem::path& base = {}) {
    Options o;
    o.inputs = {input}, o.channel = channel, o.base = base;
    return o;
  }
};

TEST_F(CalibrationLibrary, GivesWhatTheCommandGives) {
  const std::string board = CalibrationRecordings::get().board(), wall = CalibrationRecordings::get().wall();
  const std::string sensor_model = sensor("demo-camera");
  expect_same({"camera", board, "--channel", "left/real", "--target", kBoard}, [&] {
    auto o = of<CameraCalibrationOptions>(board, "left/real");
    o.target = kBoard;
    return calibrate_camera(o);
  });
  expect_same({"stereo", board, "--channel", "left/real", "--right-channel", "right", "--target", kBoard,
               "--left-model", sensor_model},
              [&] {
                auto o = of<StereoCalibrationOptions>(board, "left/real");
                o.right_channel = "right", o.target = kBoard, o.left_model_file = sensor_model;
                return calibrate_stereo(o);
              });
  expect_same(
      {"extrinsics", board, "--camera", "left/real", "--camera-model", sensor_model, "--second", "top",
       "--target", kBoard, "--rough", "0.2,0.22,0.02,0,-8,5", "--views", "8"},
      [&] {
        auto o = of<ExtrinsicsCalibrationOptions>(board);
        o.camera = "left/real", o.camera_model_file = sensor_model, o.second = "top", o.target = kBoard;
        o.rough = "0.2,0.22,0.02,0,-8,5", o.views = 8;
        return calibrate_extrinsics(o);
      },
      false);
  expect_same({"delay", board, "--first", "turntable:0", "--second", "left/real", "--target", kBoard,
               "--camera-model", sensor_model},
              [&] {
                auto o = of<DelayCalibrationOptions>(board);
                o.first = "turntable:0", o.second = "left/real", o.target = kBoard,
                o.camera_model_file = sensor_model;
                return calibrate_delay(o);
              });
  expect_same({"twin", board, "--channel", "left"},
              [&] { return calibrate_twin(of<TwinCalibrationOptions>(board, "left")); });
  expect_same({"lidar", board, "--channel", "top", "--base", sensor("velodyne-vlp16")}, [&] {
    return calibrate_lidar(of<LidarCalibrationOptions>(board, "top", sensor("velodyne-vlp16")));
  });
  expect_same({"tof", wall, "--base", sensor("sr4000")},
              [&] { return calibrate_tof(of<TofCalibrationOptions>(wall, "", sensor("sr4000"))); });
}

TEST_F(CalibrationLibrary, FailsWithAnErrorThatNamesThePlace) {
  CameraCalibrationOptions none;
  none.target = kBoard;
  const auto nothing = calibrate_camera(none);
  ASSERT_FALSE(nothing);
  EXPECT_EQ(nothing.error().code, ErrorCode::bad_input);
  EXPECT_EQ(nothing.error().where, "INPUT");
  const auto no_folder =
      calibrate_photon(of<PhotonCalibrationOptions>(dir / "flats", "", sensor("demo-camera")));
  ASSERT_FALSE(no_folder);
  EXPECT_EQ(no_folder.error().code, ErrorCode::not_found);
  EXPECT_THAT(no_folder.error().where, HasSubstr("flats"));
  const auto no_base = calibrate_photon(of<PhotonCalibrationOptions>(dir / "flats"));
  ASSERT_FALSE(no_base);
  EXPECT_EQ(no_base.error().where, "--base");
  // The base went away after the fit: nothing is written, of the parts neither.
  CalibrationResult result;
  result.base = dir / "gone.yaml";
  result.parts.push_back({"left", {}, {}});
  const auto saved = save_sensor_model(result, dir / "rig.yaml");
  ASSERT_FALSE(saved);
  EXPECT_EQ(saved.error().code, ErrorCode::not_found);
  EXPECT_THAT(files(), IsEmpty());
  EXPECT_EQ(part_file("a/rig.yaml", "left"), "a/rig.left.yaml");
}

TEST_F(CalibrationLibrary, DetailsAreAValue) {
  CalibrationDetails a;
  a.json()["rms"] = 0.5;
  CalibrationDetails b = a;
  EXPECT_EQ(b.json()["rms"], 0.5);
  b.json()["rms"] = 1;
  EXPECT_EQ(a.json()["rms"], 0.5);
  a = std::move(b);
  EXPECT_EQ(json::parse(a.text()), json::parse(R"({"rms": 1})"));
  b.json()["more"] = std::numeric_limits<double>::quiet_NaN();  // whatever was left in it
  EXPECT_TRUE(json::parse(b.text())["more"].is_null());
}

}  // namespace
}  // namespace rigor::test
