// `rigor sense` and runs with simulated LiDARs and time-of-flight cameras, from the rig to the files.
#include <ImfChannelList.h>
#include <ImfFrameBuffer.h>
#include <ImfHeader.h>
#include <ImfInputFile.h>
#include <ImfStringAttribute.h>
#include <gmock/gmock.h>

#include <cmath>
#include <cstring>
#include <map>
#include <nlohmann/json.hpp>
#include <sstream>

#include "sensor-hal/record/replay_source.h"
#include "tests/cli/sensing_fixture.h"

namespace rigor::test {
namespace {

using nlohmann::json;
using ::testing::AllOf;
using ::testing::HasSubstr;

/// PCD as its format's description has it: fields by name, little-endian, each as a double.
struct Pcd {
  std::size_t width = 0, height = 0;
  std::map<std::string, std::vector<double>> fields;
  [[nodiscard]] std::size_t points() const { return width * height; }
};
Pcd read_pcd(const std::filesystem::path& file) {
  Pcd pcd;
  const std::string bytes = read_file(file);
  std::istringstream in(bytes);
  std::vector<std::string> names, types;
  std::vector<std::size_t> sizes;
  for (std::string line; std::getline(in, line);) {
    std::istringstream words(line);
    std::string key, word;
    words >> key;
    if (key == "FIELDS")
      while (words >> word) names.push_back(word);
    if (key == "TYPE")
      while (words >> word) types.push_back(word);
    if (key == "SIZE")
      while (words >> word) sizes.push_back(std::stoul(word));
    if (key == "WIDTH") words >> pcd.width;
    if (key == "HEIGHT") words >> pcd.height;
    if (key == "DATA") break;
  }
  std::size_t at = static_cast<std::size_t>(in.tellg());
  for (std::size_t p = 0; p < pcd.points(); ++p)
    for (std::size_t f = 0; f < names.size(); at += sizes[f++]) {
      if (at + sizes[f] > bytes.size()) {
        ADD_FAILURE() << "fewer bytes than points";
        return pcd;
      }
      double value = 0;
      if (types[f] == "F") {
        float v = 0;
        std::memcpy(&v, bytes.data() + at, 4);
        value = v;
      } else {
        std::int64_t v = 0;
        std::memcpy(&v, bytes.data() + at, sizes[f]);
        if (types[f] == "I") v = static_cast<std::int32_t>(v);
        value = static_cast<double>(v);
      }
      pcd.fields[names[f]].push_back(value);
    }
  EXPECT_EQ(at, bytes.size()) << "more bytes than points";
  return pcd;
}

/// The range of the point nearest to this azimuth.
double range_at(const Pcd& pcd, double azimuth_deg) {
  double best = 1e9, range = std::nan("");
  for (std::size_t i = 0; i < pcd.points(); ++i) {
    const double x = pcd.fields.at("x")[i], y = pcd.fields.at("y")[i];
    const double off = std::abs(std::atan2(y, x) * 180 / M_PI - azimuth_deg);
    if (off < best) best = off, range = std::hypot(x, y);
  }
  return best < 0.6 ? range : std::nan("");
}

std::vector<float> plane(const std::filesystem::path& file, const std::string& name) {
  Imf::InputFile in(file.c_str());
  const auto box = in.header().dataWindow();
  const auto width = static_cast<std::size_t>(box.max.x + 1),
             height = static_cast<std::size_t>(box.max.y + 1);
  std::vector<float> values(width * height, -1);
  Imf::FrameBuffer buffer;
  buffer.insert(name, Imf::Slice(Imf::FLOAT, reinterpret_cast<char*>(values.data()), 4, 4 * width));
  in.setFrameBuffer(buffer);
  in.readPixels(0, box.max.y);
  return values;
}

class Sense : public SensingBench {
 protected:
  Pcd sense_pcd(const std::string& channel, std::vector<std::string> more = {}) {
    std::vector<std::string> words{"sense", "rig.yaml", "--channel", channel, "-o", "out.pcd", "--force"};
    words.insert(words.end(), more.begin(), more.end());
    const Said said = in_dir(words);
    EXPECT_EQ(said.status, 0) << said.err;
    return said.status == 0 ? read_pcd(dir / "out.pcd") : Pcd{};
  }
  [[nodiscard]] int files() const {
    int n = 0;
    for ([[maybe_unused]] const auto& entry : std::filesystem::directory_iterator(dir.path())) ++n;
    return n;
  }
};

TEST_F(Sense, OfAScannerGivesPointsThatOtherProgramsRead) {
  const Pcd pcd = sense_pcd("flat");
  ASSERT_GT(pcd.points(), 100u);
  EXPECT_EQ(pcd.height, 1u);
  for (const char* field : {"x", "y", "z", "intensity", "t", "ring", "return"})
    EXPECT_EQ(pcd.fields.count(field), 1u) << field;
  EXPECT_NEAR(range_at(pcd, 0), 0.8, 0.03) << "the near face of the box";
  EXPECT_NEAR(range_at(pcd, 40), 4 / std::cos(40 * M_PI / 180), 0.05) << "the wall";
  EXPECT_TRUE(std::is_sorted(pcd.fields.at("t").begin(), pcd.fields.at("t").end())) << "in order of firing";
}

TEST_F(Sense, SeesTheJointsOfTheWorldWhereTheyStand) {
  EXPECT_NEAR(range_at(sense_pcd("flat", {"--joint", "turntable=60"}), 60), 0.8, 0.03);
  EXPECT_NEAR(range_at(sense_pcd("flat", {"--joint", "turntable=60"}), 0), 4, 0.03) << "it has gone";
}

TEST_F(Sense, FromAPlatformThatMovesMeasuresFromWhereItIsThen) {
  scanner_rig(
      "    T_world_sensor: { position_m: [-2, 1, 0], roll_pitch_yaw_deg: [0, 0, 0] }\n"
      "    motion: { velocity_m_per_s: [1.5, 0, 0] }\n");
  EXPECT_NEAR(range_at(sense_pcd("flat"), 0), 6, 0.03);
  // A revolution takes 40 ms; the beam straight ahead is fired 10 ms after its begin.
  EXPECT_NEAR(range_at(sense_pcd("flat", {"--at", "2", "--ideal"}), 0), 3 - 1.5 * 0.01, 0.003);
}

TEST_F(Sense, OnAPlatformThatTurnsLooksElsewhere) {
  scanner_rig(
      "    T_world_sensor: { position_m: [0, 5, 0], roll_pitch_yaw_deg: [0, 0, 0] }\n"
      "    motion: { yaw_rate_deg_per_s: 20 }\n");
  // After 2 s and 10 ms it has turned by 40.2 degrees.
  EXPECT_NEAR(range_at(sense_pcd("flat", {"--at", "2", "--ideal"}), 0), 4 / std::cos(40.2 * M_PI / 180),
              0.003);
}

TEST_F(Sense, OnANodeOfTheWorldGoesWithIt) {
  scanner_rig(
      "    parent: turntable\n"
      "    T_parent_sensor: { position_m: [0, 0, 1], roll_pitch_yaw_deg: [0, 0, 0] }\n");
  EXPECT_NEAR(range_at(sense_pcd("flat", {"--ideal"}), 0), 4, 0.002);
  EXPECT_NEAR(range_at(sense_pcd("flat", {"--ideal", "--joint", "turntable=35"}), 0),
              4 / std::cos(35 * M_PI / 180), 0.002);
  EXPECT_NEAR(range_at(sense_pcd("flat", {"--ideal", "--joint", "turntable=35"}), -35), 4, 0.002);
}

TEST_F(Sense, OfATimeOfFlightCameraWritesRangeAmplitudeAndPoints) {
  const Said said = in_dir({"sense", "rig.yaml", "--channel", "tof", "--ideal", "-o", "out.exr", "--json"});
  ASSERT_EQ(said.status, 0) << said.err;
  EXPECT_EQ(json::parse(said.out)["returns"], 32 * 24);
  const auto range = plane(dir / "out.exr", "range"), amplitude = plane(dir / "out.exr", "amplitude");
  ASSERT_EQ(range.size(), 32u * 24u);
  // The middle looks along +x at the box; the corner at the wall, along a longer ray.
  EXPECT_NEAR(range[12 * 32 + 16], 1.8 * std::hypot(1.0, 0.5 / 40, 0.5 / 40), 1e-3);
  EXPECT_NEAR(range[0], 5 * std::hypot(1.0, 15.5 / 40, 11.5 / 40), 1e-3);
  EXPECT_GT(amplitude[12 * 32 + 16], amplitude[0]);

  const Pcd pcd = sense_pcd("tof", {"--ideal"});
  EXPECT_EQ(pcd.width, 32u);
  EXPECT_EQ(pcd.height, 24u);
  EXPECT_NEAR(pcd.fields.at("z")[0], 5, 1e-3) << "optical frame: depth along z";
  EXPECT_LT(pcd.fields.at("x")[0], 0) << "the left column lies to the left";
  EXPECT_EQ(in_dir({"sense", "rig.yaml", "--channel", "tof", "-o", "out.png"}).status, 0);
  EXPECT_GT(std::filesystem::file_size(dir / "out.png"), 100u);
}

TEST_F(Sense, WritesTheTruthOfEveryElement) {
  for (const auto& [channel, output] : {std::pair{"flat", "a.pcd"}, {"tof", "b.exr"}, {"camera", "c.png"}}) {
    const Said said = in_dir({"sense", "rig.yaml", "--channel", channel, "--ideal", "-o", output, "--truth",
                              std::string(channel) + "-truth.exr"});
    ASSERT_EQ(said.status, 0) << said.err;
  }
  const auto range = plane(dir / "tof-truth.exr", "range"), node = plane(dir / "tof-truth.exr", "node");
  ASSERT_EQ(range.size(), 32u * 24u);
  EXPECT_NEAR(range[12 * 32 + 16], 1.8, 0.01);
  EXPECT_NE(node[12 * 32 + 16], node[0]) << "the box and the wall are two nodes";
  EXPECT_NEAR(plane(dir / "tof-truth.exr", "normal.Z")[12 * 32 + 16], -1, 1e-3) << "faces the camera";
  const auto names = Imf::InputFile(file("tof-truth.exr").c_str())
                         .header()
                         .typedAttribute<Imf::StringAttribute>("class_names")
                         .value();
  EXPECT_THAT(names, HasSubstr("Body"));
  // One row, a sample for each point.
  EXPECT_EQ(plane(dir / "flat-truth.exr", "range").size(), read_pcd(dir / "a.pcd").points());
  EXPECT_EQ(plane(dir / "camera-truth.exr", "flow.X").size(), 64u * 48u);
}

TEST_F(Sense, WithOnlyOneEffectShowsThatOneAlone) {
  const double ideal = range_at(sense_pcd("flat", {"--ideal"}), 40);
  EXPECT_NE(range_at(sense_pcd("flat", {"--only", "range_noise"}), 40), ideal);
  const double rounded = range_at(sense_pcd("flat", {"--only", "quantisation"}), 40);
  EXPECT_NEAR(rounded, ideal, 0.0006);
  EXPECT_NEAR(std::remainder(rounded, 0.001), 0, 2e-6);
  const Said said = in_dir({"sense", "rig.yaml", "--channel", "tof", "--only", "wigling", "-o", "x.png"});
  EXPECT_EQ(said.status, 2);
  EXPECT_THAT(said.err, AllOf(HasSubstr("wigling"), HasSubstr("wiggling_bias"), HasSubstr("flying_pixels")));
}

TEST_F(Sense, ShowsWhatEffectsAddToRanges) {
  const auto ranges = [&](const std::string& name, const std::vector<std::string>& options) {
    std::vector<std::string> arguments{"sense", "rig.yaml", "--channel", "tof", "-o", name, "--force"};
    arguments.insert(arguments.end(), options.begin(), options.end());
    EXPECT_EQ(in_dir(arguments).status, 0);
    return plane(dir / name, "range");
  };
  for (const char* effect : {"none", "trembling"}) {
    const auto with = ranges("with.exr", {"--only", effect}),
               without = ranges("without.exr", {"--only", "none"}),
               difference = ranges("difference.exr", {"--only", effect, "--difference"});
    ASSERT_EQ(difference.size(), with.size());
    double sum = 0;
    for (std::size_t i = 0; i < with.size(); ++i) {
      if (!std::isfinite(difference[i])) continue;
      EXPECT_EQ(difference[i], with[i] - without[i]);
      sum += std::abs(double{difference[i]});
    }
    EXPECT_EQ(sum > 0, std::string(effect) != "none") << effect;
  }
}

TEST_F(Sense, RefusesWhatContradictsItself) {
  const std::vector<std::pair<std::vector<std::string>, std::string>> cases{
      {{"--channel", "tof", "--ideal", "--only", "lens"}, "--only"},
      {{"--channel", "flat", "--difference"}, "--difference"},
      {{"--channel", "tof", "--at", "nan"}, "--at"},
      {{"--channel", "tof", "--at", "1e30"}, "--at"},
      {{"--channel", "tof", "--at=-1"}, "--at"},
      {{"--channel", "tof", "--truth", "./same.exr"}, "--truth"},
  };
  for (const auto& [options, named] : cases) {
    std::vector<std::string> arguments{"sense", "rig.yaml", "-o",
                                       named == "--truth" ? "same.exr" : "same.png"};
    arguments.insert(arguments.end(), options.begin(), options.end());
    const Said said = in_dir(arguments);
    EXPECT_EQ(said.status, 2) << named;
    EXPECT_THAT(said.err, HasSubstr(named));
    EXPECT_FALSE(std::filesystem::exists(dir / "same.exr") || std::filesystem::exists(dir / "same.png"))
        << named;
  }
}

TEST_F(Sense, IsTheSampleOfAVirtualRun) {
  const Said run = in_dir({"run", "rig.yaml", "--record", "run.mcap", "--json"});
  ASSERT_EQ(run.status, 0) << run.err;
  const Pcd sensed = sense_pcd("flat", {"--at", "0.12"});  // the fourth
  auto recording = Recording::open(file("run.mcap"));
  ASSERT_TRUE(recording);
  ReplaySource source(*recording, "flat");
  ChannelConfig config;
  config.name = "flat";
  config.kind = SampleKind::point_cloud;
  config.period = milliseconds(40);
  config.latency = milliseconds(50);
  config.params = *ConfigDocument::parse("{}");
  ASSERT_TRUE(source.configure(config));
  ASSERT_TRUE(source.arm({.virtual_time = true}));
  ASSERT_TRUE(source.start(BenchTime(0)));
  bool compared = false;
  for (int k = 0; k < 500; ++k) {
    const BenchTime now = BenchTime(0) + milliseconds(k);
    source.complete_until(now);
    while (SampleLease s = source.poll(now)) {
      if (s->stamp.sequence != 3) continue;
      ASSERT_EQ(s->as<PointCloudInfo>()->count, sensed.points());
      for (std::size_t i = 0; i < sensed.points(); ++i) {
        LidarPoint p;
        std::memcpy(&p, s->bytes().data() + i * sizeof p, sizeof p);
        ASSERT_EQ(p.x_m, static_cast<float>(sensed.fields.at("x")[i])) << i;
        ASSERT_EQ(p.remission, static_cast<float>(sensed.fields.at("intensity")[i])) << i;
        ASSERT_EQ(p.t_offset_ns, sensed.fields.at("t")[i]) << i;
      }
      compared = true;
    }
  }
  EXPECT_TRUE(compared);
  ASSERT_TRUE(source.stop());
}

TEST_F(Sense, RefusesWithThePlaceAndLeavesNothing) {
  const int before = files();
  const auto refused = [&](std::vector<std::string> more, const std::string& message) {
    std::vector<std::string> words{"sense", "rig.yaml"};
    words.insert(words.end(), more.begin(), more.end());
    const Said said = in_dir(words);
    EXPECT_EQ(said.status, 2) << said.err;
    EXPECT_THAT(said.err, HasSubstr(message));
    EXPECT_EQ(files(), before);
  };
  refused({"--channel", "flat", "-o", "x.exr"}, "ends in .png, .pcd for a channel of kind point_cloud");
  refused({"--channel", "camera", "-o", "x.pcd"}, "ends in .png, .exr for a channel of kind image");
  refused({"--channel", "tof", "-o", "x.exr", "--truth", "x.png"},
          "--truth: expected a file that ends in .exr");
  refused({"--channel", "tof", "-o", "x.exr", "--set", "channels.tof.renderer=rastre"},
          "did you mean 'raster'");
  refused({"--channel", "tof", "-o", "x.exr", "--set", "channels.tof.renderer=scene"}, "rays");
  refused({"--channel", "tof", "-o", "x.exr", "--set", "channels.tof.parent=turntabel",  //
           "--set", "channels.tof.T_parent_sensor={position_m: [0,0,0], quaternion_wxyz: [1,0,0,0]}"},
          "did you mean turntable?");
  refused({"--channel", "tof", "-o", "x.exr", "--set", "channels.tof.quality={sub_rays: 3}"},
          "channels.tof.quality.sub_rays: expected no such key here: it is for LiDARs");
  refused({"--channel", "tof", "-o", "x.exr", "--set", "channels.tof.quality={sky_rays: 1}"},
          "channels.tof.quality.sky_rays: expected no such key here: it is for cameras by rays");
  refused({"--channel", "tof", "-o", "x.exr", "--set", "channels.tof.sensor=scanner.yaml"},
          "channels.tof.sensor: expected the sensor model of a time-of-flight camera, got scanner.yaml, the "
          "sensor model of a "
          "LiDAR");
  refused({"--channel", "camera", "-o", "x.exr", "--set", "channels.camera.sensor=scanner.yaml"},
          "channels.camera.sensor: expected the sensor model of a camera, got scanner.yaml, the sensor model "
          "of a LiDAR");
  refused({"--channel", "flat", "-o", "x.pcd", "--set", "channels.flat.sensor=camera.yaml"},
          "channels.flat.sensor: expected the sensor model of a LiDAR, got camera.yaml, the sensor model of "
          "a camera");
  refused({"--channel", "flat", "-o", "x.pcd", "--set", "channels.flat.T_world_sensor.above_ground=true"},
          "channels.flat.T_world_sensor.position_m: expected a place on the terrain, got 0, 0");
  refused({"--channel", "flat", "-o", "x.pcd", "--set", "simulation.weather={rain_mph: 5}"},
          "simulation.weather.rain_mph: unknown key; did you mean rain_mmph?");
  refused({"--channel", "flat", "-o", "x.pcd", "--set", "simulation.weather={fog_visibility_m: 0}"},
          "simulation.weather.fog_visibility_m");
  refused({"--channel", "flat", "-o", "x.pcd", "--set", "channels.flat.kind=image"}, "x.pcd");
}

// Fog of 100 m visibility takes 3.91/V of the light per metre (Kim, below 0.5 km alike in all colours), twice
// on the way to the wall and back; rain of 100 mm/h 3.65e-4 · 100^0.63. Visibilities lie on a grid of 2 %,
// the nearest of which is here 0.3 % off.
TEST_F(Sense, InTheRigsWeatherSeesWhatTheAirLeaves) {
  const auto remission_at_40_deg = [&](std::vector<std::string> more) {
    std::vector<std::string> words{"--set", "channels.flat.renderer=rays"};
    words.insert(words.end(), more.begin(), more.end());
    const Pcd pcd = sense_pcd("flat", words);
    for (std::size_t i = 0; i < pcd.points(); ++i)
      if (std::abs(std::atan2(pcd.fields.at("y")[i], pcd.fields.at("x")[i]) * 180 / M_PI - 40) < 0.3)
        return pcd.fields.at("intensity")[i];
    return std::nan("");
  };
  const double range_m = 4 / std::cos(40 * M_PI / 180);
  const double clear = remission_at_40_deg({});
  ASSERT_GT(clear, 0);
  const double fog = remission_at_40_deg({"--set", "simulation.weather={fog_visibility_m: 100}"});
  EXPECT_NEAR(fog / clear, std::exp(-2 * 3.91 / 100 * range_m), 0.01);
  const double rain = remission_at_40_deg({"--set", "simulation.weather={rain_mmph: 100}"});
  EXPECT_NEAR(rain / clear, std::exp(-2 * 3.65e-4 * std::pow(100, 0.63) * range_m), 0.01);
  EXPECT_LT(rain, clear);
}

TEST_F(Sense, OfAFittedSensorModelTakesTheDeviceThatIsAskedFor) {
  rig(kChannels);
  write_file(dir / "scanner.yaml", std::string(kScanner) + R"(
calibration:
  version: 1
  kind: lidar
  model: bias
  parameters:
    - { name: range_bias_m, value: 0, sigma: 0.1, path: range.bias_mm, scale: 1000 }
  covariance: [0.01]
  residuals: { unit: m, count: 100, rejected: 0, rms: 0.004 }
)");
  const auto range = [&](const std::string& draw) {
    return range_at(
        sense_pcd("flat", {"--only", "beam_bias", "--set", "channels.flat.calibration_draw=" + draw}), 0);
  };
  const double as_stated = range("0"), first = range("1"), second = range("2");
  EXPECT_NEAR(as_stated, 0.8, 0.002) << "the block on the turntable";
  EXPECT_GT(std::abs(first - as_stated), 0.001);
  EXPECT_GT(std::abs(second - first), 0.001);
  EXPECT_LT(std::abs(first - as_stated), 0.5) << "five standard deviations";
  EXPECT_EQ(range("1"), first);
}

TEST_F(Sense, TakesWorldsOfNodesToo) {
  rig(kChannels);
  const Said said =
      in_dir({"sense", "rig.yaml", "--channel", "round", "--ideal", "-o", "x.pcd", "--set",
              "simulation.world=" + config("worlds/testbed.yaml"), "--set",
              "channels.round.T_world_sensor={position_m: [0, 0, 1], quaternion_wxyz: [1, 0, 0, 0]}"});
  ASSERT_EQ(said.status, 0) << said.err;
  EXPECT_NEAR(range_at(read_pcd(dir / "x.pcd"), 0), 5, 0.2) << "the hall's wall, by any of the four beams";
}

TEST_F(Sense, CamerasWithoutARendererAreDrawnBySceneWhereThatLeavesNothingOutAndElseByRays) {
  rig("channels:\n  camera:\n    kind: image\n    backend: simulated\n    rate_hz: 20\n    latency_ms: 30\n  "
      "  sensor: "
      "camera.yaml\n    T_world_sensor: { position_m: [-3, 0, 0.5], look_at_m: [1, 0, 0] }\n");
  const auto run = [&](const std::string& keys, const std::string& renderer,
                       std::vector<std::string> more = {}) {
    write_file(dir / "camera.yaml", kCamera + keys);
    std::vector<std::string> words{"run", "rig.yaml", "--json", "--duration", "0.1"};
    if (!renderer.empty()) words.insert(words.end(), {"--set", "channels.camera.renderer=" + renderer});
    words.insert(words.end(), more.begin(), more.end());
    return in_dir(words);
  };
  const auto recorded = [&](const std::string& keys, const std::string& renderer) {
    const Said said = run(keys, renderer);
    EXPECT_EQ(said.status, 0) << keys << said.err;
    return said.status == 0 ? json::parse(said.out)["input_sha256"].get<std::string>() : "";
  };
  EXPECT_EQ(recorded("", ""), recorded("", "scene"));
  EXPECT_NE(recorded("", ""), recorded("", "rays"));
  for (const auto& [effect, name] : std::vector<std::pair<std::string, std::string>>{
           {"projection: kannala_brandt\n", "the projection of this lens"},
           {"bloom: { fraction: 0.1, radius_px: 3 }\n", "bloom"},
           {"processing: { gamma: 2.2 }\n", "the camera's image processing"},
           {"shutter: { line_time_us: 20 }\n", "a rolling shutter"},
           {"noise: { hot_pixel_share: 0.05 }\n", "hot pixels"}}) {
    EXPECT_EQ(recorded(effect, ""), recorded(effect, "rays")) << effect;
    const Said said = run(effect, "scene");
    EXPECT_EQ(said.status, 2) << effect;
    EXPECT_THAT(said.err, HasSubstr("channels.camera.renderer: expected rays or raster: the renderer scene "
                                    "does not draw " +
                                    name));
  }
  const Said moving = run("", "scene", {"--set", "channels.camera.motion={velocity_m_per_s: [1, 0, 0]}"});
  EXPECT_EQ(moving.status, 2);
  EXPECT_THAT(moving.err, HasSubstr("does not draw a camera that moves"));
  const Said told = run("", "scene", {"--set", "channels.camera.quality={sky_samples: 3}"});
  EXPECT_EQ(told.status, 2);
  EXPECT_THAT(
      told.err,
      HasSubstr("channels.camera.quality.sky_samples: expected no such key here: it is for cameras by rays"));
}

TEST_F(Sense, SkyRaysOfARigAskWhichSkyIsHidden) {
  rig("channels:\n  camera:\n    kind: image\n    backend: simulated\n    rate_hz: 20\n    latency_ms: 30\n"
      "    sensor: camera.yaml\n    renderer: rays\n"
      "    T_world_sensor: { position_m: [-3, 0, 0.5], look_at_m: [1, 0, 0] }\n");
  const auto digest = [&](const std::string& quality) {
    const Said said = in_dir({"run", "rig.yaml", "--json", "--duration", "0.1", "--set",
                              "channels.camera.quality={" + quality + "}"});
    EXPECT_EQ(said.status, 0) << said.err;
    return said.status == 0 ? json::parse(said.out)["input_sha256"].get<std::string>() : "";
  };
  EXPECT_EQ(digest("samples_per_pixel: 1"), digest("samples_per_pixel: 1, sky_rays: 0"));
  EXPECT_NE(digest("samples_per_pixel: 1"), digest("samples_per_pixel: 1, sky_rays: 1"));
}

TEST_F(Sense, CamerasByRaysTakeMoreSamplesWherePicturesAreUnevenUnlessTheRigSaysHowMany) {
  rig("channels:\n  camera:\n    kind: image\n    backend: simulated\n    rate_hz: 20\n    latency_ms: 30\n"
      "    sensor: camera.yaml\n"
      "    T_world_sensor: { position_m: [-3, 0, 0.5], look_at_m: [1, 0, 0] }\n");
  const auto digest = [&](const std::string& quality) {
    const Said said =
        in_dir({"run", "rig.yaml", "--json", "--duration", "0.1", "--set", "channels.camera." + quality});
    EXPECT_EQ(said.status, 0) << said.err;
    return said.status == 0 ? json::parse(said.out)["input_sha256"].get<std::string>() : "";
  };
  // `quality` without `renderer` is of rays.
  const std::string by_itself = digest("renderer=rays");
  EXPECT_EQ(digest("quality={pixel_step: 1}"), by_itself);
  EXPECT_EQ(digest("quality={samples_per_pixel: 1, uneven_samples: 7, sky_samples: 64}"), by_itself);
  EXPECT_NE(digest("quality={uneven_samples: 0}"), by_itself);
  const std::string one = digest("quality={samples_per_pixel: 1}");
  EXPECT_NE(one, by_itself);
  EXPECT_EQ(digest("quality={samples_per_pixel: 1, uneven_samples: 0, sky_samples: 0}"), one);

  const Said both = in_dir({"sense", "rig.yaml", "--channel", "camera", "-o", "x.png", "--set",
                            "channels.camera.quality={pixel_step: 2}", "--set",
                            "channels.camera.tolerance={radiance: 0.1}"});
  EXPECT_EQ(both.status, 2);
  EXPECT_THAT(both.err, HasSubstr("channels.camera.quality: expected one of `quality` and `tolerance`"));
  const Said of_raster = in_dir({"run", "rig.yaml", "--set", "channels.camera.quality={supersampling: 2}"});
  EXPECT_EQ(of_raster.status, 2);
  EXPECT_THAT(of_raster.err,
              HasSubstr("supersampling: expected no such key here: it is for cameras by raster"));
}

// ------------------------------------------------------------------------------------------ runs

TEST_F(Sense, RunsRepeatByteForByteOnAnyNumberOfWorkers) {
  std::string first, seen;
  for (const char* workers : {"1", "3", "2"}) {
    const Said said = in_dir({"run", "rig.yaml", "--record", "run.mcap", "--json", "--workers", workers});
    ASSERT_EQ(said.status, 0) << said.err;
    const json result = json::parse(said.out);
    if (first.empty()) {
      first = read_file(dir / "run.mcap");
      seen = result["input_sha256"];
      for (const json& c : result["channels"]) {
        EXPECT_GE(c["fresh"], 3) << c["name"];
        EXPECT_EQ(c["lost_samples"], 0) << c["name"];
      }
    }
    EXPECT_EQ(result["input_sha256"], seen) << workers;
    EXPECT_TRUE(read_file(dir / "run.mcap") == first) << workers << " workers";
  }
  ASSERT_FALSE(seen.empty());
  // And replay shows the same.
  const Said replay = in_dir({"replay", "run.mcap", "--record", "again.mcap", "--json"});
  ASSERT_EQ(replay.status, 0) << replay.err;
  EXPECT_EQ(json::parse(replay.out)["input_sha256"], seen);
  const Said inspect = in_dir({"inspect", "run.mcap"});
  EXPECT_EQ(inspect.status, 0);
  EXPECT_THAT(inspect.out, AllOf(HasSubstr("/flat/points"), HasSubstr("/tof/range"),
                                 HasSubstr("/round/points"), HasSubstr("/tof/range/amplitude")));
}

TEST_F(Sense, RunsDependOnTheSeed) {
  std::string seen[2];
  for (int i = 0; i < 2; ++i) {
    const Said said = in_dir({"run", "rig.yaml", "--json", "--set", "seed=" + std::to_string(i + 1)});
    ASSERT_EQ(said.status, 0) << said.err;
    seen[i] = json::parse(said.out)["input_sha256"];
  }
  EXPECT_NE(seen[0], seen[1]);
}

TEST_F(Sense, ARunOnTheWallClockReportsThem) {
  const Said said =
      in_dir({"run", "rig.yaml", "--clock", "wall", "--duration", "1", "--json", "--report", "r"});
  ASSERT_EQ(said.status, 0) << said.err;
  const json result = json::parse(said.out);
  ASSERT_EQ(result["channels"].size(), 4u);
  for (const json& c : result["channels"]) EXPECT_GT(c["age"]["count"], 0) << c["name"];
  EXPECT_TRUE(result["warnings"].is_array());
  EXPECT_THAT(read_file(dir / "r/index.html"), AllOf(HasSubstr("round"), HasSubstr("tof")));
}

}  // namespace
}  // namespace rigor::test
