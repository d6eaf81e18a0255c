// `rigor calibrate photon` and `shading` as a user calls them: recordings of a simulated camera in, a sensor
// model out that the simulator takes; and what is said of inputs that are none.
#include <gmock/gmock.h>

#include <nlohmann/json.hpp>
#include <opencv2/imgcodecs.hpp>

#include "tests/cli/command.h"

namespace rigor::test {
namespace {

using nlohmann::json;
using ::testing::HasSubstr;

/// A sky alone, as bright everywhere: the inside of an integrating sphere. What there is else is behind the
/// camera.
const char* const kSphere = R"(
materials:
  - { name: white, reflectance: { red: 0.8, green: 0.8, blue: 0.8, nir: 0.8 } }
bodies:
  - { name: behind, size_m: [0.1, 0.1, 0.1], material: white, position_m: [0, -50, 0] }
sky:
  zenith_radiance_w_per_m2_sr: { red: LIGHT, green: LIGHT, blue: LIGHT, nir: 0 }
  horizon_radiance_w_per_m2_sr: { red: LIGHT, green: LIGHT, blue: LIGHT, nir: 0 }
)";
const char* const kCamera = R"(
width_px: 96
height_px: 80
exposure_us: 800
intrinsics: { fx_px: 160 }
optics: { f_number: 4 }
vignetting: { a2: -0.6 }
noise: { system_gain_dn_per_e: 0.38, black_level_dn: 60, full_well_e: 8000, read_noise_e: 2.3,
         dark_current_e_per_s: 3000, dsnu_e: 1.2, prnu: 0.008, adc_bits: 12TEMPERATURE }
)";
const char* const kRig = R"(
name: flats
clock: virtual
duration_s: 0.25
simulation: { world: day.yaml }
channels:
  camera: { kind: image, backend: simulated, rate_hz: 20, latency_ms: 40, sensor: camera.yaml, renderer: rays,
            quality: { samples_per_pixel: 1 }, pixel_format: Mono12,
            T_world_sensor: { position_m: [0, 0, 1], look_at_m: [0, 1, 2] } }
)";

std::string with(std::string text, const std::string& word, const std::string& by) {
  for (std::size_t at = text.find(word); at != std::string::npos; at = text.find(word, at + by.size()))
    text.replace(at, word.size(), by);
  return text;
}

class CalibratePhoton : public ::testing::Test {
 protected:
  void SetUp() override {
    write_file(dir / "day.yaml", with(kSphere, "LIGHT", "1"));
    write_file(dir / "night.yaml", with(kSphere, "LIGHT", "0"));
    write_file(dir / "camera.yaml", with(kCamera, "TEMPERATURE", ""));
    write_file(dir / "warm.yaml", with(kCamera, "TEMPERATURE", ", temperature_c: 39"));
    write_file(dir / "rig.yaml", kRig);
  }
  Said run(std::vector<std::string> words) const { return rigor(std::move(words), dir.path()); }
  std::string record(const std::string& name, int exposure_us, const char* world, const char* sensor) const {
    const Said said = run({"run", "rig.yaml", "--record", name, "--set",
                           "channels.camera.exposure_us=" + std::to_string(exposure_us), "--set",
                           std::string("simulation.world=") + world, "--set",
                           std::string("channels.camera.sensor=") + sensor});
    EXPECT_EQ(said.status, 0) << said.err;
    return name;
  }
  TempDir dir;
};

TEST_F(CalibratePhoton, RecordingsOfASimulatedCameraGiveItsSensorModelBack) {
  std::vector<std::string> words{"calibrate", "photon"};
  for (const int us : {200, 400, 600, 800, 1000, 1150, 2500, 4000})
    words.push_back(record("flat_" + std::to_string(us) + "us.mcap", us, "day.yaml", "camera.yaml"));
  for (const char* sensor : {"camera.yaml", "warm.yaml"})
    for (const int us : {200, 40000})
      words.push_back(
          record("dark_" + std::string(sensor[0] == 'w' ? "39c_" : "25c_") + std::to_string(us) + "us.mcap",
                 us, "night.yaml", sensor));
  words.insert(words.end(), {"--base", "camera.yaml", "-o", "fitted.yaml", "--report", "report", "--json"});
  const Said said = run(words);
  ASSERT_EQ(said.status, 0) << said.err << said.out;
  const json answer = json::parse(said.out);
  const auto value = [&](const char* name) {
    if (!answer["parameters"].contains(name)) {
      ADD_FAILURE() << name << said.out.substr(0, 4000);
      return 0.0;
    }
    return answer["parameters"][name]["value"].get<double>();
  };
  // Runs of one seed share their draws: all levels have the relative error of one, 0.8 % of a variance of
  // 96x80 pixels and 5 frames, four times of which is allowed. Patterns are not judged for the same reason.
  EXPECT_NEAR(value("system_gain_dn_per_e"), 0.38, 0.032 * 0.38);
  EXPECT_NEAR(value("read_noise_e"), 2.3, 0.05 * 2.3);
  EXPECT_NEAR(value("black_level_dn"), 60, 0.1);
  EXPECT_NEAR(value("dark_current_e_per_s"), 3000, 0.035 * 3000);
  EXPECT_NEAR(value("dark_doubling_k"), 7, 0.2);
  EXPECT_NEAR(value("full_well_e"), 8000, 0.033 * 8000);
  EXPECT_THAT(answer["warnings"].dump(), HasSubstr("pixel by pixel")) << "that the draws are shared is seen";
  ASSERT_FALSE(answer["twin"].empty());
  for (const json& t : answer["twin"])
    EXPECT_NEAR(t["twin_sigma_dn"].get<double>() / t["sigma_dn"].get<double>(), 1, 0.06) << t.dump();
  EXPECT_THAT(read_file(dir / "report/index.html"), HasSubstr("recording and twin"));

  const Said sensed = run({"sense", "rig.yaml", "--channel", "camera", "--set",
                           "channels.camera.sensor=fitted.yaml", "--at", "0.1", "-o", "twin.png"});
  ASSERT_EQ(sensed.status, 0) << sensed.err;
  const Said real = run({"sense", "rig.yaml", "--channel", "camera", "--at", "0.1", "-o", "real.png"});
  ASSERT_EQ(real.status, 0) << real.err;
  const cv::Mat a = cv::imread((dir / "twin.png").string(), cv::IMREAD_UNCHANGED),
                b = cv::imread((dir / "real.png").string(), cv::IMREAD_UNCHANGED);
  ASSERT_FALSE(a.empty() || b.empty());
  EXPECT_NEAR(cv::mean(a)[0], cv::mean(b)[0], 0.04 * cv::mean(b)[0]);

  // The same flats are a flat field: the lens comes back, too.
  const Said shading = run({"calibrate", "shading", "flat_800us.mcap", "--dark", "dark_25c_200us.mcap",
                            "--base", "fitted.yaml", "-o", "shaded.yaml", "--json"});
  ASSERT_EQ(shading.status, 0) << shading.err << shading.out;
  const json lens = json::parse(shading.out);
  EXPECT_EQ(lens["model"], "r2") << shading.out.substr(0, 3000);
  EXPECT_NEAR(lens["parameters"]["a2"]["value"].get<double>(), -0.6, 0.02);
  EXPECT_EQ(lens["twin"]["residuals"].size(), lens["twin"]["quantiles"].size());
  EXPECT_EQ(run({"sense", "rig.yaml", "--channel", "camera", "--set", "channels.camera.sensor=shaded.yaml",
                 "--at", "0.1", "-o", "shaded.png"})
                .status,
            0);
}

TEST_F(CalibratePhoton, BadInputSaysWhatWasExpected) {
  cv::imwrite((dir / "flat_20ms_1.png").string(), cv::Mat(32, 32, CV_8UC3, cv::Scalar(10, 90, 200)));
  cv::imwrite((dir / "grey.png").string(), cv::Mat(32, 32, CV_8UC1, cv::Scalar(90)));
  cv::Mat fraction(32, 32, CV_32FC1, cv::Scalar(0.5));
  fraction.at<float>(3, 3) = std::nanf("");
  cv::imwrite((dir / "flat_30ms_1.tiff").string(), fraction);
  write_file(dir / "flat_40ms_1.exr", "\x76\x2f\x31\x01 and more");
  write_file(dir / "flat_50ms_1.png", "no picture");
  write_file(dir / "cut_20ms.mcap", "\x89MCAP0\r\n");
  record("flat_60ms.mcap", 800, "day.yaml", "camera.yaml");
  for (const auto& [input, words] : std::vector<std::pair<std::vector<std::string>, std::string>>{
           {{"flat_20ms_1.png"}, "raw mosaic"},
           {{"grey.png"}, "exposure time in the file's name"},
           {{"flat_30ms_1.tiff"}, "fractions"},
           {{"flat_40ms_1.exr"}, "OpenEXR"},
           {{"flat_50ms_1.png"}, "none that can be read"},
           {{"cut_20ms.mcap"}, "cut_20ms.mcap"},
           {{"nothing_20ms.png"}, "nothing of that name"},
           {{"flat_60ms.mcap", "--channel", "right"}, "camera"},
           {{"flat_60ms.mcap", "--model", "three_gains"}, "one_gain_bent"}}) {
    std::vector<std::string> all{"calibrate", "photon"};
    all.insert(all.end(), input.begin(), input.end());
    const Said said = run(all);
    EXPECT_EQ(said.status, 2) << input.front() << said.out << said.err;
    EXPECT_THAT(said.err, HasSubstr(words)) << input.front();
  }
}

}  // namespace
}  // namespace rigor::test
