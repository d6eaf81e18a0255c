// What the reference libraries of MCAP and of ROS 2 messages (npm, tests/npm) read from a recording, against
// what was written: an independent check of framing, indexes, compression, checksums, CDR and schemas.
#include <unistd.h>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <openssl/sha.h>

#include <cstdio>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "tests/paths.h"
#include "tests/sensor-hal/record/sample_fixture.h"

namespace rigor::record {
namespace {

using namespace test;
using nlohmann::json;

const std::string kFolder = rigor::test::source_dir() + "/tests/npm";

std::string sha256(Bytes bytes) {
  unsigned char digest[SHA256_DIGEST_LENGTH];
  SHA256(reinterpret_cast<const unsigned char*>(bytes.data()), bytes.size(), digest);
  std::string text;
  char two[3];
  for (const unsigned char c : digest) std::snprintf(two, sizeof two, "%02x", c), text += two;
  return text;
}

json read_by_others(const std::string& path) {
  const std::string command = "node '" + kFolder + "/read_recording.mjs' '" + path + "'";
  FILE* pipe = ::popen(command.c_str(), "r");
  if (pipe == nullptr) throw std::runtime_error("cannot start node");
  std::string out;
  char part[65536];
  for (std::size_t n; (n = std::fread(part, 1, sizeof part, pipe)) > 0;) out.append(part, n);
  if (const int status = ::pclose(pipe); status != 0) throw std::runtime_error("node failed, see above");
  return json::parse(out);
}

class ByOthers : public testing::TestWithParam<Compression> {
 protected:
  void SetUp() override {
    if (std::system("node --version > /dev/null 2>&1") != 0) GTEST_SKIP() << "node is not installed";
    if (!std::filesystem::exists(kFolder + "/node_modules"))
      GTEST_SKIP() << "tests/npm/node_modules is absent; run ./dev deps test, or npm ci --prefix tests/npm";
    path_ = testing::TempDir() + "rigor_by_others_" + std::to_string(static_cast<int>(GetParam())) + "_" +
            std::to_string(getpid()) + ".mcap";
  }
  void TearDown() override { std::remove(path_.c_str()); }

  std::unique_ptr<McapWriter> create() {
    return must(McapWriter::open(must(open_file_sink(path_)),
                                 {.compression = GetParam(), .chunk_bytes = 20'000, .direct_bytes = 10'000}));
  }
  std::string path_;
};
INSTANTIATE_TEST_SUITE_P(Record, ByOthers,
                         testing::Values(Compression::none, Compression::lz4, Compression::zstd),
                         [](const auto& p) {
                           return p.param == Compression::none ? "none" : std::string(to_string(p.param));
                         });

const json& only_message(const json& all, const std::string& topic) {
  return all.at("topics").at(topic).at("messages").at(0).at("value");
}

TEST_P(ByOthers, ReadSamplesOfEveryKind) {
  auto writer = create();
  std::map<std::string, std::size_t> expected;
  std::vector<Sample> images;
  for (const PixelFormat f : kPixelFormats) images.push_back(image_sample(f, 160, 120));
  for (int kind = 1; kind <= static_cast<int>(kLastSampleKind); ++kind) {
    SampleChannel channel = channel_of(static_cast<SampleKind>(kind));
    channel.topic = "/kind" + std::to_string(kind);
    SampleWriter out(*writer, channel);
    const auto small = samples_of(static_cast<SampleKind>(kind));
    for (const Sample& sample : kind == 1 ? images : small)
      out.write(sample), ++expected[channel.topic + "/stamp"];
  }
  must(writer->add_metadata({"rig", {{"seed", "7"}}}));
  must(writer->add_attachment({"rig.yaml", "text/yaml", 5, 6, noise(40, 1)}));
  must(writer->close());

  const json got = read_by_others(path_);
  EXPECT_EQ(got["profile"], "ros2");
  EXPECT_EQ(got["library"], "rigor");
  EXPECT_EQ(got["ordered"], true);
  EXPECT_EQ(got["stream"]["done"], true);
  EXPECT_EQ(got["compressions"], json::array({std::string(to_string(GetParam()))}));
  EXPECT_GT(got["chunks"], 3);
  EXPECT_EQ(got["chunks"], got["stream"]["records"]["Chunk"]);
  EXPECT_EQ(got["statistics"]["messageCount"], std::to_string(writer->statistics().messages));
  EXPECT_EQ(got["statistics"]["messageCount"],
            std::to_string(got["stream"]["records"]["Message"].get<int>()));
  EXPECT_EQ(got["metadata"][0]["values"]["seed"], "7");
  EXPECT_EQ(got["attachments"][0]["sha256"], sha256(noise(40, 1)));
  for (const auto& [topic, count] : expected)
    EXPECT_EQ(got["topics"][topic]["messages"].size(), count) << topic;

  const json& pictures = got["topics"]["/kind1"]["messages"];
  EXPECT_EQ(got["topics"]["/kind1"]["qos"], "");
  EXPECT_EQ(got["topics"]["/kind1"]["encoding"], "cdr");
  const char* encodings[] = {"mono8",       "mono16",       "mono16",       "mono12p",      "mono16",
                             "bayer_rggb8", "bayer_rggb16", "bayer_rggb16", "bayer_rggb16", "rgb8"};
  ASSERT_EQ(pictures.size(), images.size());
  for (std::size_t i = 0; i < images.size(); ++i) {
    const json& picture = pictures[i]["value"];
    EXPECT_EQ(picture["encoding"], encodings[i]);
    EXPECT_EQ(picture["data"]["bytes"], images[i].size_bytes);
    EXPECT_EQ(picture["data"]["sha256"], sha256(images[i].bytes()));
    EXPECT_EQ(picture["width"], 160);
    EXPECT_EQ(picture["height"], 120);
    EXPECT_EQ(picture["header"]["frame_id"], "dut_frame");
    EXPECT_EQ(picture["header"]["stamp"]["sec"], 1'700'000'005);
    EXPECT_EQ(picture["header"]["stamp"]["nanosec"], 70'000'001);
  }
  const json& settings = only_message(got, "/kind1/settings");
  EXPECT_EQ(settings["pixel_format"], "Mono8");
  EXPECT_EQ(settings["gain_db"], 1.0 / 3);
  EXPECT_EQ(settings["exposure_ns"], "123000");
  const json& stamp = only_message(got, "/kind1/stamp");
  EXPECT_EQ(stamp["channel"], "dut");
  EXPECT_EQ(stamp["t_capture_ns"], "5070000001");
  EXPECT_EQ(stamp["t_release_ns"], "5073000001");
  EXPECT_EQ(stamp["validity"], kSaturated | kClockUnsure);
  const json& range = only_message(got, "/kind2");
  EXPECT_EQ(range["encoding"], "32FC1");
  EXPECT_EQ(range["data"]["sha256"], sha256(Bytes(noise(20 * 30 * 8, 3)).first(20 * 30 * 4)));
  const json& cloud = only_message(got, "/kind3");
  EXPECT_EQ(cloud["data"]["sha256"], sha256(noise(100 * sizeof(LidarPoint), 3)));
  EXPECT_EQ(cloud["fields"][5]["name"], "ring");
  EXPECT_EQ(cloud["fields"][5]["offset"], 20);
  EXPECT_EQ(cloud["is_dense"], false);
  const json& frame = only_message(got, "/kind4");
  EXPECT_EQ(frame["id"], 0x1abcdef0);
  EXPECT_EQ(frame["data"], json::array({0, 31, 62, 93, 124, 155, 186, 217}));
  const json& fd = only_message(got, "/kind4/fd");
  EXPECT_EQ(fd["data"].size(), 64u);
  EXPECT_EQ(fd["data"][63], 192);
  const json& registers = only_message(got, "/kind5");
  EXPECT_EQ(registers["values"], json::array({0.1, -1e300, 65535}));
  EXPECT_EQ(registers["names"], json::array({"a", "b", "c"}));
  EXPECT_EQ(only_message(got, "/kind6")["pose"]["orientation"]["w"], 0.5);
  EXPECT_EQ(only_message(got, "/kind6")["pose"]["position"]["x"], 1e6 / 3);
  EXPECT_EQ(only_message(got, "/kind7")["text"], "prüfen");
  const json& imu = only_message(got, "/kind8");
  EXPECT_EQ(imu["orientation_covariance"][0], -1);
  EXPECT_EQ(imu["linear_acceleration"]["z"], 9.81);
  EXPECT_EQ(imu["angular_velocity"]["y"], -35);
  EXPECT_EQ(got["topics"]["/kind8"]["messages"].size(), 2u);
  EXPECT_EQ(got["topics"]["/kind8/temperature"]["messages"].size(), 1u);
  EXPECT_EQ(only_message(got, "/kind8/temperature")["temperature"], 21.5);
  const json& fixes = got["topics"]["/kind9"]["messages"];
  const json& qualities = got["topics"]["/kind9/quality"]["messages"];
  ASSERT_EQ(fixes.size(), 5u);
  const std::array ros_status{-1, 0, 1, 2, 2};
  for (std::size_t i = 0; i < 5; ++i) {
    EXPECT_EQ(fixes[i]["value"]["status"]["status"], ros_status[i]);
    EXPECT_EQ(fixes[i]["value"]["position_covariance_type"], i == 0 ? 0 : 3);
    EXPECT_EQ(qualities[i]["value"]["status"], i);
  }
  EXPECT_EQ(fixes[1]["value"]["longitude"], -6.987654321);
  EXPECT_EQ(fixes[1]["value"]["altitude"], 512.25);
  EXPECT_EQ(fixes[1]["value"]["position_covariance"][8], 1.0 / 3);
  EXPECT_EQ(qualities[1]["value"]["satellites"], 17);
  const json& odometry = only_message(got, "/kind10");
  EXPECT_EQ(odometry["header"]["frame_id"], "odom");
  EXPECT_EQ(odometry["child_frame_id"], "dut_frame");
  EXPECT_EQ(odometry["pose"]["pose"]["position"]["x"], 1e3 / 3);
  EXPECT_EQ(odometry["pose"]["covariance"][35], 16);
  EXPECT_EQ(odometry["pose"]["covariance"][1], 0);
  EXPECT_EQ(odometry["twist"]["covariance"][7], 22);
  EXPECT_EQ(odometry["twist"]["twist"]["angular"]["z"], 6);
  EXPECT_EQ(only_message(got, "/kind10/wheels")["name"], json::array({"left", "right"}));
  EXPECT_EQ(only_message(got, "/kind10/wheels")["position"], json::array({-100.5, 200.25}));
  EXPECT_EQ(only_message(got, "/kind10/wheels")["velocity"], json::array({7.5, -8.5}));
}

TEST_P(ByOthers, ReadTheOtherMessages) {
  auto writer = create();
  CdrWriter cdr;
  const auto write = [&](const std::string& topic, const auto& message) {
    using M = std::decay_t<decltype(message)>;
    const auto schema = must(writer->add_schema(std::string(M::kType), "ros2msg", schema_text(M::kType)));
    const auto channel = must(writer->add_channel({.schema = schema, .topic = topic}));
    must(writer->write({channel, 0, 1, 1}, must(cdr.write(message))));
  };
  const msg::Header header{{12, 34}, "f"};
  const auto jpeg = noise(3000, 8);
  msg::CameraInfo info{header, 1024, 1280, "rational_polynomial", {1, 2, 3}, {}, {},
                       {},     1,    2,    {3, 4, 5, 6, true}};
  info.k[8] = 9.5;
  info.p[11] = 12.5;
  write("/info", info);
  write("/scan", msg::LaserScan{header, -1.5f, 1.5f, 0.25f, 0, 0.1f, 0.5f, 30, {1, 2, 3}, {}});
  write("/tf", msg::TFMessage{
                   {{header, "c", {{1, 2, 3}, {0, 0, 0, 1}}}, {header, "dd", {{4, 5, 6}, {0, 0, 1, 0}}}}});
  write("/odom", msg::Odometry{header, "base", {{{1, 2, 3}, {}}, {}}, {{{7, 8, 9}, {}}, {}}});
  write("/jpeg", msg::CompressedImage{header, "jpeg", jpeg});
  msg::Imu imu{header, {}, {}, {1, 2, 3}, {}, {4, 5, 6}, {}};
  imu.linear_acceleration_covariance[8] = 0.5;
  write("/imu", imu);
  write("/fix", msg::NavSatFix{header, {-1, 5}, 50.5, 6.25, 100, {}, 3});
  write("/diagnostics",
        msg::DiagnosticArray{header, {{2, "n", "m", "h", {{"k", "v"}, {"k2", ""}}}, {0, "", "", "", {}}}});
  write("/ports", msg::PortVisibility{7, -5, {{"a", 1, 2, 3, 4, 5}, {"bc", 6, 7, -8, 9, 10}}});
  write("/command", msg::Command{header, "arm", 3, -4, {"x"}, {0.5}});
  write("/clock", msg::Clock{{1577836800, 250}});
  must(writer->close());

  const json got = read_by_others(path_);
  EXPECT_EQ(got["topics"].size(), 11u);
  EXPECT_EQ(only_message(got, "/clock")["clock"], (json{{"sec", 1577836800}, {"nanosec", 250}}));
  EXPECT_EQ(only_message(got, "/info")["d"], json::array({1, 2, 3}));
  EXPECT_EQ(only_message(got, "/info")["k"][8], 9.5);
  EXPECT_EQ(only_message(got, "/info")["p"][11], 12.5);
  EXPECT_EQ(only_message(got, "/info")["roi"]["do_rectify"], true);
  EXPECT_EQ(only_message(got, "/scan")["ranges"], json::array({1, 2, 3}));
  EXPECT_EQ(only_message(got, "/scan")["intensities"], json::array());
  EXPECT_EQ(only_message(got, "/tf")["transforms"][1]["transform"]["translation"]["z"], 6);
  EXPECT_EQ(only_message(got, "/odom")["twist"]["twist"]["linear"]["y"], 8);
  EXPECT_EQ(only_message(got, "/jpeg")["data"]["sha256"], sha256(jpeg));
  EXPECT_EQ(only_message(got, "/imu")["linear_acceleration_covariance"][8], 0.5);
  EXPECT_EQ(only_message(got, "/fix")["status"]["status"], -1);
  EXPECT_EQ(only_message(got, "/fix")["latitude"], 50.5);
  EXPECT_EQ(only_message(got, "/fix")["position_covariance_type"], 3);
  EXPECT_EQ(only_message(got, "/diagnostics")["status"][0]["values"][1]["key"], "k2");
  EXPECT_EQ(only_message(got, "/ports")["entries"][1]["t_capture_ns"], "-8");
  EXPECT_EQ(only_message(got, "/command")["t_effect_ns"], "-4");
  EXPECT_EQ(only_message(got, "/command")["values"], json::array({0.5}));
}

/// Field by field, as a program with the definitions alone finds them.
TEST_P(ByOthers, ReadCloudsInEveryLayoutAndScansBesideThem) {
  constexpr std::uint32_t kPoints = 50;
  for (const auto& [name, layout] : kPointLayouts) {
    Sample sample;
    sample.stamp = some_stamp(1);
    sample.info = PointCloudInfo{kPoints};
    sample.reserve(kPoints * sizeof(LidarPoint));
    sample.size_bytes = kPoints * sizeof(LidarPoint);
    auto* points = reinterpret_cast<LidarPoint*>(sample.memory().data());
    for (std::uint32_t i = 0; i < kPoints; ++i)
      points[i] = {2 + static_cast<float>(i), 0, 0, 100, static_cast<std::int32_t>(i * 1000), 3, 0, 0};
    auto writer = create();
    SampleChannel channel = channel_of(SampleKind::point_cloud);
    channel.topic = "/lidar/points";
    channel.points = layout;
    channel.scan = ScanLine{0, 0.1, 10, 0, 0.1, 0.5, 30};
    SampleWriter(*writer, channel).write(sample);
    must(writer->close());
    const json got = read_by_others(path_);
    const json& cloud = only_message(got, "/lidar/points");
    EXPECT_EQ(cloud["width"], kPoints) << name;
    EXPECT_EQ(cloud["point_step"], point_step(layout));
    const auto fields = point_fields(layout);
    ASSERT_EQ(cloud["fields"].size(), fields.size());
    for (std::size_t i = 0; i < fields.size(); ++i) {
      EXPECT_EQ(cloud["fields"][i]["name"], fields[i].name);
      EXPECT_EQ(cloud["fields"][i]["offset"], fields[i].offset);
      EXPECT_EQ(cloud["fields"][i]["datatype"], fields[i].datatype);
    }
    EXPECT_EQ(got["topics"].contains("/lidar/points/timing"), layout != PointLayout::rigor);
    const json& scan = only_message(got, "/lidar/scan");
    EXPECT_EQ(scan["ranges"].size(), 10U);
    EXPECT_EQ(scan["intensities"][0], 100);
  }
}

}  // namespace
}  // namespace rigor::record
