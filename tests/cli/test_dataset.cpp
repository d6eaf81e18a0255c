// `rigor dataset`: from a rig to a folder, as a user and as a program that reads it sees it.
#include <fcntl.h>
#include <gmock/gmock.h>
#include <signal.h>
#include <sys/file.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <map>
#include <nlohmann/json.hpp>
#include <set>

#include "bench/dataset/dataset.h"
#include "tests/cli/sensing_fixture.h"

namespace rigor::test {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;
using ::testing::AllOf;
using ::testing::HasSubstr;

/// A mask from COCO's text, by its description: an implementation of its own, to check the program's.
std::vector<bool> mask_of(const json& segmentation) {
  const std::size_t height = segmentation["size"][0], width = segmentation["size"][1];
  const std::string text = segmentation["counts"];
  std::vector<long> counts;
  for (std::size_t at = 0; at < text.size();) {
    long value = 0;
    int bits = 0;
    bool more = true;
    while (more && at < text.size()) {
      const int c = text[at++] - 48;
      value += static_cast<long>(c % 32) << bits;
      bits += 5;
      more = c / 32 == 1;
      if (!more && (c / 16) % 2 == 1) value -= 1L << bits;
    }
    counts.push_back(counts.size() > 2 ? value + counts[counts.size() - 2] : value);
  }
  std::vector<bool> mask(width * height, false);
  std::size_t at = 0;
  bool in = false;
  for (const long count : counts) {
    for (long i = 0; i < count && at < mask.size(); ++i, ++at) mask[at % height * width + at / height] = in;
    in = !in;
  }
  EXPECT_EQ(at, mask.size()) << "runs that do not fill the picture";
  return mask;
}

/// Numbers of a file of NumPy whose elements are float32.
std::vector<float> floats_of(const fs::path& file) {
  const std::string bytes = read_file(file);
  const std::size_t header =
      10 + static_cast<unsigned char>(bytes[8]) + 256U * static_cast<unsigned char>(bytes[9]);
  EXPECT_THAT(bytes.substr(0, header), HasSubstr("'<f4'"));
  std::vector<float> values((bytes.size() - header) / sizeof(float));
  std::memcpy(values.data(), bytes.data() + header, values.size() * sizeof(float));
  return values;
}

/// Every file below a folder, by its name there.
std::map<std::string, std::string> files_below(const fs::path& dir) {
  std::map<std::string, std::string> files;
  for (const auto& entry : fs::recursive_directory_iterator(dir))
    if (entry.is_regular_file()) files[fs::relative(entry.path(), dir).string()] = read_file(entry.path());
  return files;
}
void expect_same(const std::map<std::string, std::string>& a, const std::map<std::string, std::string>& b) {
  std::set<std::string> names;
  for (const auto& [name, bytes] : a) names.insert(name);
  for (const auto& [name, bytes] : b) names.insert(name);
  for (const std::string& name : names) {
    ASSERT_TRUE(a.contains(name) && b.contains(name)) << name << " is in one of them alone";
    EXPECT_TRUE(a.at(name) == b.at(name)) << name << " differs";
  }
}

class DatasetCommand : public SensingBench {
 protected:
  Said make(std::vector<std::string> more) {
    std::vector<std::string> words{"dataset", "rig.yaml"};
    words.insert(words.end(), more.begin(), more.end());
    return in_dir(words);
  }
  json sample(const std::string& folder, const std::string& number) {
    return json::parse(read_file(dir / (folder + "/samples/" + number + ".json")));
  }
  /// All annotations of a channel, of all splits.
  json annotations(const std::string& folder, const std::string& channel) {
    json all = json::array();
    for (const char* split : {"train", "val", "test"}) {
      const json coco =
          json::parse(read_file(dir / (folder + "/annotations/" + channel + "_" + split + ".json")));
      all.insert(all.end(), coco["annotations"].begin(), coco["annotations"].end());
    }
    return all;
  }
};

TEST_F(DatasetCommand, HasBoxesMasksAndDepthsThatFitWhatIsThere) {
  const Said said = make({"--channels", "camera,tof", "--sample", "1", "-o", "out"});
  ASSERT_EQ(said.status, 0) << said.err;
  const json boxes = annotations("out", "camera");
  const auto block =
      std::find_if(boxes.begin(), boxes.end(), [](const json& b) { return b.value("name", "") == "block"; });
  ASSERT_NE(block, boxes.end()) << boxes.dump();
  // A cube of 0.4 m, 4.03 m away, in the middle of a picture of 60 pixels a radian: its near face is 6.6
  // pixels wide.
  const json& box = (*block)["bbox"];
  EXPECT_NEAR(box[0].get<double>() + box[2].get<double>() / 2, 32, 1);
  EXPECT_NEAR(box[1].get<double>() + box[3].get<double>() / 2, 24, 1.5);
  EXPECT_NEAR(box[2].get<double>(), 6.5, 1.1);
  EXPECT_NEAR((*block)["depth_m"].get<double>(), 3.9, 0.15);
  EXPECT_EQ((*block)["cut_off"], false);

  const std::vector<bool> mask = mask_of((*block)["segmentation"]);
  const std::vector<float> depth = floats_of(dir / "out/camera/depth/000000.npy");
  ASSERT_EQ(mask.size(), 64u * 48u);
  ASSERT_EQ(depth.size(), mask.size());
  int left = 64, right = -1, top = 48, bottom = -1, area = 0;
  for (int i = 0; i < 64 * 48; ++i) {
    if (!mask[static_cast<std::size_t>(i)]) continue;
    ++area;
    left = std::min(left, i % 64), right = std::max(right, i % 64);
    top = std::min(top, i / 64), bottom = std::max(bottom, i / 64);
    EXPECT_NEAR(depth[static_cast<std::size_t>(i)], 3.95, 0.3) << "pixel " << i;
  }
  EXPECT_EQ(box, json({left, top, right - left + 1, bottom - top + 1}));
  EXPECT_EQ((*block)["area"], area);
  // The wall behind is a plane across the axis only if depths are depths and not ranges.
  const json s = sample("out", "000000");
  const json& lens = s["channels"]["tof"]["intrinsics"];
  EXPECT_EQ(lens["fx_px"], 40);
  EXPECT_FALSE(annotations("out", "tof").empty());
  for (const float d : floats_of(dir / "out/tof/depth/000000.npy"))
    if (d > 4.5F) {
      EXPECT_NEAR(d, 5, 0.001) << "the wall, 5 m in front of the time-of-flight camera";
    }
  EXPECT_THAT(read_file(dir / "out/README.md"),
              AllOf(HasSubstr("camera/depth/*.npy"), HasSubstr("| 1 | Body | yes |")));
  EXPECT_THAT(said.out, HasSubstr("out: 1 of 1 samples"));
}

TEST_F(DatasetCommand, LabelsPointsToo) {
  ASSERT_EQ(make({"--channels", "round", "--sample", "1", "-o", "out"}).status, 0);
  const std::string bytes = read_file(dir / "out/round/points/000000.npy");
  const std::size_t header =
      10 + static_cast<unsigned char>(bytes[8]) + 256U * static_cast<unsigned char>(bytes[9]);
  EXPECT_THAT(bytes.substr(0, header),
              AllOf(HasSubstr("('x', '<f4')"),
                    HasSubstr("('class', '|u1'), ('node', '<u8'), ('true_range', '<f4')")));
  constexpr std::size_t kPoint = 4 * 4 + 4 + 2 + 1 + 1 + 8 + 4;
  ASSERT_EQ((bytes.size() - header) % kPoint, 0u);
  std::size_t points = 0;
  for (std::size_t at = header; at < bytes.size(); at += kPoint, ++points) {
    float x, y, z, range;
    std::memcpy(&x, &bytes[at], 4), std::memcpy(&y, &bytes[at + 4], 4), std::memcpy(&z, &bytes[at + 8], 4);
    std::memcpy(&range, &bytes[at + kPoint - 4], 4);
    EXPECT_EQ(bytes[at + 23], 1) << "a Body";
    // Of the beam's middle, which meets a wall here wherever the beam does: also beside the plane of an axis,
    // where Embree loses rays that it walks together with one in that plane.
    EXPECT_NEAR(std::sqrt(x * x + y * y + z * z), range, 0.1);
  }
  EXPECT_EQ(sample("out", "000000")["channels"]["round"]["points"], points);
  EXPECT_GT(points, 100u);
}

const std::vector<std::string> kDrawn{"--channels",
                                      "camera",
                                      "--within=-2,-1,0,1",
                                      "--height",
                                      "0.3..1",
                                      "--yaw",
                                      "-30..30",
                                      "--vary",
                                      "joint.turntable=0..360",
                                      "--vary",
                                      "simulation.weather=clear,fog"};
std::vector<std::string> drawn(std::vector<std::string> more) {
  std::vector<std::string> words = kDrawn;
  words.insert(words.end(), more.begin(), more.end());
  return words;
}

TEST_F(DatasetCommand, ASampleIsTheSameWhateverElseIsMade) {
  ASSERT_EQ(make(drawn({"--sample", "5", "--jobs", "2", "-o", "all"})).status, 0);
  const Said said = make(drawn({"--sample", "5", "--only", "3", "--jobs", "1", "-o", "some"}));
  ASSERT_EQ(said.status, 0) << said.err;
  for (const auto& [name, bytes] : files_below(dir / "some"))
    if (name.find("000003") != std::string::npos) {
      EXPECT_EQ(bytes, read_file(dir / ("all/" + name))) << name;
      EXPECT_NE(bytes,
                read_file(dir / ("all/" + std::string(name).replace(name.find("000003"), 6, "000002"))))
          << name;
    }
  EXPECT_FALSE(fs::exists(dir / "some/samples/000002.json"));
  ASSERT_EQ(make(drawn({"--sample", "5", "-o", "some"})).status, 0);
  expect_same(files_below(dir / "all"), files_below(dir / "some"));
}

TEST_F(DatasetCommand, GoesOnAfterAKillAsIfNothingHadHappened) {
  ASSERT_EQ(make(drawn({"--sample", "6", "-o", "whole"})).status, 0);
  const auto words = rigor_words(drawn({"--sample", "6", "-o", "killed"}));
  for (int kill = 1; kill <= 2; ++kill) {
    std::vector<std::string> command = words;
    command.insert(std::find(command.begin(), command.end(), "--channels"), {"dataset", "rig.yaml"});
    Command running(command, dir.path());
    while (running.running() && !fs::exists(dir / ("killed/samples/00000" + std::to_string(kill) + ".json")))
      usleep(1000);
    running.signal(SIGKILL);
    (void)running.wait();
  }
  write_file(dir / "killed/camera/depth/.000009.1.part.npy", "left behind");
  const Said said = make(drawn({"--sample", "6", "-o", "killed"}));
  ASSERT_EQ(said.status, 0) << said.err;
  expect_same(files_below(dir / "whole"), files_below(dir / "killed"));
}

TEST_F(DatasetCommand, RefusesAFolderThatIsNotItsOwn) {
  ASSERT_EQ(make({"--channels", "flat", "--sample", "1", "-o", "out"}).status, 0);
  const auto before = files_below(dir / "out");
  const auto refused = [&](std::vector<std::string> more, const std::string& why) {
    std::vector<std::string> words{"--channels", "flat", "-o", "out"};
    words.insert(words.end(), more.begin(), more.end());
    const Said said = make(words);
    EXPECT_EQ(said.status, 2) << said.err;
    EXPECT_THAT(said.err, HasSubstr(why));
  };
  refused({"--sample", "1", "--seed", "8"}, "options.seed is 1 there, and 8 here");
  refused({"--sample", "2"}, "options.samples is 1 there, and 2 here");
  write_file(dir / "scanner.yaml", std::string(kScanner) + "echoes: { separation_m: 0.3 }\n");
  refused({"--sample", "1"}, "inputs.scanner.yaml is");
  expect_same(before, files_below(dir / "out"));
  fs::create_directory(dir / "full");
  write_file(dir / "full/letter.txt", "mine");
  EXPECT_THAT(make({"--channels", "flat", "--sample", "1", "-o", "full"}).err, HasSubstr("letter.txt"));
}

TEST_F(DatasetCommand, HasItsFolderForItselfAlone) {
  ASSERT_EQ(make({"--channels", "flat", "--sample", "1", "-o", "out"}).status, 0);
  const int held = ::open((dir / "out").c_str(), O_RDONLY | O_DIRECTORY);
  ASSERT_EQ(::flock(held, LOCK_EX | LOCK_NB), 0);
  const Said said = make({"--channels", "flat", "--sample", "1", "-o", "out"});
  ::close(held);
  EXPECT_EQ(said.status, 2);
  EXPECT_THAT(said.err, HasSubstr("another process is writing this dataset"));
}

TEST_F(DatasetCommand, LeavesOutPosesInsideOfThingsAndSaysWhy) {
  write_file(dir / "poses.csv",
             "x_m,y_m,z_m,yaw_deg\n-1,0,0.5,0\n4.1,0,0.5,0\n0,2,0.5,0\n3.8,1,0.5,180\n0,0,-1,0\n");
  const Said said = make({"--channels", "camera", "--poses", "poses.csv", "-o", "out"});
  ASSERT_EQ(said.status, 0) << said.err;
  EXPECT_THAT(said.out, AllOf(HasSubstr("out: 2 of 5 samples"), HasSubstr("3 left out"),
                              HasSubstr("1 below the ground")));
  for (const char* gone : {"000001", "000003", "000004"}) {
    EXPECT_TRUE(sample("out", gone)["channels"].empty()) << gone;
    EXPECT_FALSE(fs::exists(dir / ("out/camera/image/" + std::string(gone) + ".png")));
  }
  EXPECT_EQ(sample("out", "000003")["rejected"][0]["reason"], "near Body");
  EXPECT_EQ(sample("out", "000004")["rejected"][0]["reason"], "below the ground");
  EXPECT_TRUE(fs::exists(dir / "out/camera/image/000002.png"));
  // The carrier of a camera is level: what the rig tilts down stays tilted down.
  const json T = sample("out", "000000")["channels"]["camera"]["T_world_sensor"];
  EXPECT_NEAR(T["position_m"][0].get<double>(), -1, 1e-9);
  const json& q = T["quaternion_wxyz"];
  const Eigen::Quaterniond rotation(q[0], q[1], q[2], q[3]);
  EXPECT_NEAR((rotation * Eigen::Vector3d::UnitZ()).z(), -0.5 / std::sqrt(16.25), 1e-6);
}

TEST_F(DatasetCommand, DrawsDevicesWhoseModelsSayHowSureTheyAre) {
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
  ASSERT_EQ(make({"--channels", "flat,round", "--sample", "3", "--draw-devices", "-o", "out"}).status, 0);
  std::set<std::uint64_t> devices;
  for (const char* number : {"000000", "000001", "000002"}) {
    devices.insert(sample("out", number)["channels"]["flat"]["device"].get<std::uint64_t>());
    EXPECT_FALSE(sample("out", number)["channels"]["round"].contains("device"))
        << "its model has no covariance";
  }
  EXPECT_EQ(devices.size(), 3u);
  const Said said = make({"--channels", "round", "--sample", "1", "--draw-devices", "-o", "none"});
  EXPECT_EQ(said.status, 2);
  EXPECT_THAT(said.err, AllOf(HasSubstr("scanner3d.yaml"), HasSubstr("calibration")));
}

TEST_F(DatasetCommand, IsDescribedByAFileWhoseMistakesHaveAPlace) {
  write_file(dir / "data.yaml",
             "rig: rig.yaml\nchannels: [flat]\nsamples: 2\nseed: 7\nposes: { within: [-1, -1, 1, 1], "
             "height_m: 0.5..1 }\n"
             "vary:\n  joint.turntable: [0, 90]\n");
  const Said said = in_dir({"dataset", "data.yaml", "-o", "out", "--sample", "1"});
  ASSERT_EQ(said.status, 0) << said.err;
  EXPECT_THAT(said.out, HasSubstr("out: 1 of 1 samples"));
  const auto wrong = [&](const std::string& text, const std::string& message) {
    write_file(dir / "bad.yaml", text);
    const Said bad = in_dir({"dataset", "bad.yaml", "-o", "bad"});
    EXPECT_EQ(bad.status, 2) << text;
    EXPECT_THAT(bad.err, HasSubstr(message)) << text;
    EXPECT_FALSE(fs::exists(dir / "bad")) << text;
  };
  wrong("rig: rig.yaml\nseed: 1\nsmaples: 2\n", "bad.yaml:3:1: smaples: unknown key; did you mean samples?");
  wrong("rig: rig.yaml\nsamples: 1\nposes: { within: [0, 0, 1, 1], height_m: 2..1 }\n",
        "bad.yaml:3:42: poses.height_m: expected");
  wrong("rig: rig.yaml\nsamples: 1\nvary:\n  joint.turntabel: 0..1\n",
        "bad.yaml:4:20: vary.joint.turntabel: expected a hinged node");
  wrong("rig: rig.yaml\nsamples: 1\nvary: { Body.colour: 1 }\n", "expected an attribute of Body");
  wrong("rig: rig.yaml\nsamples: 1\nposes: { file: no.csv }\n", "no.csv");
}

TEST_F(DatasetCommand, RefusesBadInputBeforeItTouchesAnything) {
  write_file(dir / "columns.csv", "x_m,y_m,heigth_m\n0,0,1\n");
  write_file(dir / "cell.csv", "x_m,y_m\n0,0\n1,east\n");
  const std::vector<std::pair<std::vector<std::string>, std::string>> table{
      {{"--sample", "0"}, "--sample: expected a whole number from 1"},
      {{"--sample", "1", "--channels", "cmera"}, "(camera, tof, flat, round), got \"cmera\""},
      {{}, "expected how many samples"},
      {{"--sample", "1", "--within", "0,0,1"}, "--within: expected x0,y0,x1,y1"},
      {{"--sample", "1", "--within", "0,0,1,1", "--height", "2..1"}, "--height: expected"},
      {{"--sample", "1", "--yaw", "0..90"}, "--yaw: expected it with --within or --along"},
      {{"--sample", "1", "--vary", "joint.turntable"}, "--vary: expected KEY=VALUES"},
      {{"--sample", "1", "--vary", "Atmosphere.wetness=0..2"}, "--vary Atmosphere.wetness"},
      {{"--sample", "1", "--vary", "Tree.dbh_m=1"}, "found none"},
      {{"--sample", "1", "--layers", "deep"}, "--layers: expected all, none, or some of depth"},
      {{"--sample", "1", "--split", "0,0,0"}, "--split"},
      {{"--sample", "2", "--only", "2"}, "--only: expected a whole number from 0 to 1"},
      {{"--poses", "columns.csv"}, "columns.csv:1: heigth_m: expected columns among"},
      {{"--poses", "cell.csv"}, "cell.csv:3: y_m: expected a number"},
      {{"--poses", "none.csv"}, "none.csv"},
      {{"--sample", "1", "--draw-devices"}, "calibration"},
  };
  for (const auto& [words, message] : table) {
    std::vector<std::string> all = words;
    all.insert(all.end(), {"-o", "out"});
    const Said said = make(all);
    EXPECT_EQ(said.status, 2) << message;
    EXPECT_THAT(said.err, HasSubstr(message));
    EXPECT_FALSE(fs::exists(dir / "out")) << message;
  }
}

TEST_F(DatasetCommand, SaysWhenTheDiskIsFullAndGoesOnLater) {
  // No file over 8 KiB: the depths of a picture take 12.
  std::string command = "trap '' XFSZ; ulimit -f 8; exec";
  std::vector<std::string> words =
      rigor_words({"dataset", "rig.yaml", "--channels", "camera", "--sample", "2", "-o", "out"});
  for (const std::string& word : words) command += " '" + word + "'";
  const Said said = Command({"bash", "-c", command}, dir.path()).wait();
  EXPECT_EQ(said.status, 1);
  EXPECT_THAT(said.err, AllOf(HasSubstr("no space is left"), HasSubstr("0 samples are whole")));
  EXPECT_FALSE(fs::exists(dir / "out/samples/000000.json"));
  ASSERT_EQ(make({"--channels", "camera", "--sample", "2", "-o", "out"}).status, 0);
  EXPECT_TRUE(fs::exists(dir / "out/samples/000001.json"));
}

/// The library: one sample at a time.
TEST_F(DatasetCommand, IsAGeneratorForPrograms) {
  write_file(dir / "poses.csv", "x_m,y_m,z_m\n-1,0,0.5\n4.1,0,0.5\n-2,0,0.5\n");
  DatasetOptions options;
  options.rig = dir / "rig.yaml";
  options.channels = {"camera"};
  options.poses.kind = dataset::PoseChoice::Kind::list;
  options.poses.file = dir / "poses.csv";
  auto data = Dataset::create(options);
  ASSERT_TRUE(data) << data.error().text();
  std::vector<std::uint64_t> seen;
  while (true) {
    const auto sample = (*data)->next();
    ASSERT_TRUE(sample) << sample.error().text();
    if (!*sample) break;
    seen.push_back((*sample)->index);
    ASSERT_EQ((*sample)->views.size(), 1u);
    const DatasetView& view = (*sample)->views[0];
    EXPECT_EQ(view.pixels.size(), 64u * 48u);
    EXPECT_EQ(view.depth_m.size(), 64u * 48u);
    EXPECT_EQ(view.truth.normal.size(), 3 * 64u * 48u);
    EXPECT_EQ(view.truth.flow_px.size(), 2 * 64u * 48u);
  }
  EXPECT_EQ(seen, (std::vector<std::uint64_t>{0, 2})) << "the second pose is inside a wall";
}

}  // namespace
}  // namespace rigor::test
