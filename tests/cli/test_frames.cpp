// Frames, clock, scans and layouts of points in the recordings of whole runs, in virtual time, and what
// `rigor check` finds in their data.
#include <gmock/gmock.h>

#include <cmath>
#include <filesystem>
#include <map>
#include <set>

#include "sensor-hal/record/frame_tree.h"
#include "sensor-hal/record/mcap_writer.h"
#include "sensor-hal/record/ros2_time.h"
#include "tests/cli/recorded_messages.h"
#include "tests/cli/runs_fixture.h"

namespace rigor::test {
namespace {

using nlohmann::json;
using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;
namespace msg = record::msg;

Pose pose_of(const msg::TransformStamped& t) {
  const auto& [p, q] = t.transform;
  return {{p.x, p.y, p.z}, {q.w, q.x, q.y, q.z}};
}

class RecordedFrames : public Runs {
 protected:
  /// The robot with its scanner and its camera, by `more`.
  void record(const std::string& name, std::vector<std::string> more = {}) const {
    std::vector<std::string> words{"run",        config("rigs/skid-steer.yaml"),
                                   "--clock",    "virtual",
                                   "--duration", "1.5",
                                   "--record",   file(name),
                                   "--report",   file("report")};
    words.insert(words.end(), more.begin(), more.end());
    const Said said = rigor(std::move(words));
    ASSERT_EQ(said.status, 0) << said.err << said.out;
  }
  [[nodiscard]] Said check(const std::string& name, std::vector<std::string> more = {}) const {
    more.insert(more.begin(), {"check", file(name)});
    return rigor(std::move(more));
  }
};

TEST_F(RecordedFrames, TellWhereTheRobotAndItsSensorsAre) {
  record("run.mcap");
  const auto fixed = messages_on<msg::TFMessage>(file("run.mcap"), "/tf_static");
  ASSERT_EQ(fixed.size(), 1U);
  std::map<std::string, msg::TransformStamped> place;
  for (const auto& t : fixed[0].transforms) place[t.child_frame_id] = t;
  ASSERT_TRUE(place.contains("scanner") && place.contains("camera") && place.contains("camera_optical"));
  EXPECT_EQ(place["scanner"].header.frame_id, "robot");
  EXPECT_EQ(place["camera_optical"].header.frame_id, "camera");
  // x of the camera's body looks where z of its optical frame does.
  const Pose T_robot_camera = pose_of(place["camera"]);
  const Pose T_robot_optical = record::composed(T_robot_camera, pose_of(place["camera_optical"]));
  const Pose ahead = record::composed(T_robot_camera, {{1, 0, 0}, {1, 0, 0, 0}});
  const Pose ahead_optical = record::composed(T_robot_optical, {{0, 0, 1}, {1, 0, 0, 0}});
  for (std::size_t i = 0; i < 3; ++i)
    EXPECT_NEAR(ahead.position_m[i], ahead_optical.position_m[i], 1e-12) << i;
  EXPECT_GT(ahead.position_m[0], T_robot_camera.position_m[0] + 0.9) << "it looks ahead";

  // The robot in /tf is where the truth says at the same instant.
  std::map<std::int64_t, msg::PoseStamped> truth;
  for (const auto& p : messages_on<msg::PoseStamped>(file("run.mcap"), "/truth/pose")) {
    EXPECT_EQ(p.header.frame_id, "world");
    truth[record::to_ns(p.header.stamp)] = p;
  }
  std::size_t compared = 0;
  const auto moving = messages_on<msg::TFMessage>(file("run.mcap"), "/tf");
  EXPECT_EQ(moving.size(), 150U) << "100 Hz";
  for (const auto& m : moving)
    for (const auto& t : m.transforms) {
      const auto at = truth.find(record::to_ns(t.header.stamp));
      if (t.child_frame_id != "robot" || at == truth.end()) continue;
      EXPECT_EQ(t.header.frame_id, "world");
      EXPECT_EQ(t.transform.translation.x, at->second.pose.position.x);
      EXPECT_EQ(t.transform.rotation.z, at->second.pose.orientation.z);
      ++compared;
    }
  EXPECT_GT(compared, 100U);
  // /clock runs with the log time.
  const auto clock = messages_on<msg::Clock>(file("run.mcap"), "/clock");
  ASSERT_EQ(clock.size(), 150U);
  EXPECT_EQ(record::to_ns(clock[149].clock) - record::to_ns(clock[0].clock), 1'490'000'000);
}

TEST_F(RecordedFrames, RepeatByteForByteAndComeBackInAReplay) {
  record("one.mcap");
  record("two.mcap");
  EXPECT_EQ(sha256(file("one.mcap")), sha256(file("two.mcap")));
  const Said replay = rigor({"replay", file("one.mcap"), "--record", file("again.mcap")});
  ASSERT_EQ(replay.status, 0) << replay.err;
  EXPECT_EQ(all_messages(file("again.mcap")), all_messages(file("one.mcap")));
}

TEST_F(RecordedFrames, ScansHaveTheRangesOfTheirClouds) {
  record("run.mcap");
  const auto scans = messages_on<msg::LaserScan>(file("run.mcap"), "/scanner/scan");
  const auto clouds = messages_on<msg::PointCloud2>(file("run.mcap"), "/scanner/points");
  ASSERT_EQ(scans.size(), clouds.size());
  ASSERT_GE(scans.size(), 15U);
  for (std::size_t k = 0; k < scans.size(); ++k) {
    const msg::LaserScan& scan = scans[k];
    EXPECT_EQ(scan.ranges.size(), 811U);
    EXPECT_NEAR(scan.angle_min + 810 * scan.angle_increment, scan.angle_max, 1e-4);
    EXPECT_EQ(scan.header.frame_id, "scanner");
    const auto returns = static_cast<std::size_t>(
        std::count_if(scan.ranges.begin(), scan.ranges.end(), [](float r) { return std::isfinite(r); }));
    EXPECT_EQ(returns, clouds[k].width) << "each point has a ray of its own";
    EXPECT_TRUE(std::all_of(scan.ranges.begin(), scan.ranges.end(),
                            [](float r) { return (r >= 0.05F && r <= 25) || std::isinf(r); }));
  }
}

class EveryPointLayout : public RecordedFrames, public testing::WithParamInterface<std::string> {};
INSTANTIATE_TEST_SUITE_P(RecordedFrames, EveryPointLayout, testing::Values("velodyne", "ouster", "livox"),
                         [](const auto& layout) { return layout.param; });

TEST_P(EveryPointLayout, IsReplayedExactly) {
  record("run.mcap", {"--set", "channels.scanner.points=" + GetParam(), "--json"});
  const Said replay = rigor({"replay", file("run.mcap"), "--record", file("again.mcap"), "--json"});
  ASSERT_EQ(replay.status, 0) << replay.err << "an input digest that differs fails the replay";
  EXPECT_EQ(all_messages(file("again.mcap")), all_messages(file("run.mcap")));
  EXPECT_EQ(check("run.mcap", {"--data"}).status, 0);
}

TEST_F(RecordedFrames, AreSetByTheRig) {
  record("run.mcap", {"--set",
                      "frames={root: map, rate_hz: 20, mounts: {scanner: {parent: robot.wheel_front_left, "
                      "position_m: [0, 0, 1], roll_pitch_yaw_deg: [0, 0, 0]}}}"});
  const auto moving = messages_on<msg::TFMessage>(file("run.mcap"), "/tf");
  EXPECT_EQ(moving.size(), 30U);
  EXPECT_EQ(moving.at(0).transforms.at(0).header.frame_id, "map");
  std::string parent;
  const auto fixed = messages_on<msg::TFMessage>(file("run.mcap"), "/tf_static");
  ASSERT_EQ(fixed.size(), 1U);
  for (const auto& t : fixed[0].transforms)
    if (t.child_frame_id == "scanner") parent = t.header.frame_id;
  EXPECT_EQ(parent, "robot.wheel_front_left");
  EXPECT_EQ(check("run.mcap").status, 0);

  record("none.mcap", {"--set", "frames={publish: false}"});
  for (const char* topic : {"/tf", "/tf_static", "/clock"})
    EXPECT_TRUE(all_messages(file("none.mcap")).empty() ||
                messages_on<msg::TFMessage>(file("none.mcap"), topic).empty())
        << topic;
  const Said said = check("none.mcap");
  EXPECT_EQ(said.status, 1) << "three frames, and no transforms";
  EXPECT_THAT(said.out, HasSubstr("neither /tf nor /tf_static"));

  const auto refused = [&](const std::string& frames, auto what) {
    const Said no = rigor({"run", config("rigs/skid-steer.yaml"), "--clock", "virtual", "--duration", "0.1",
                           "--set", "frames=" + frames});
    EXPECT_EQ(no.status, 2) << frames;
    EXPECT_THAT(no.err, what);
  };
  refused("{rot: map}", HasSubstr("rot"));
  refused("{mounts: {scaner: {position_m: [0, 0, 1], quaternion_wxyz: [1, 0, 0, 0]}}}",
          AllOf(HasSubstr("scaner"), HasSubstr("scanner")));
  refused("{mounts: {scanner: {parent: robbot, position_m: [0, 0, 1], quaternion_wxyz: [1, 0, 0, 0]}}}",
          HasSubstr("robbot"));
  refused("{stereo: [{left: scanner, right: camera}]}", HasSubstr("expected a channel of kind image"));
}

TEST_F(RecordedFrames, CheckJudgesDataWhereNothingIsExpected) {
  record("run.mcap");
  const Said clean = check("run.mcap", {"--json"});
  EXPECT_EQ(clean.status, 0) << clean.out;
  EXPECT_TRUE(json::parse(clean.out)["good"]);
  // The rig expects something: that is judged, and the data alone where it is asked for.
  record("expects.mcap", {"--set", "expect=[{of: scanner, missing: {max: 9}}]", "--set",
                          "channels.scanner.faults=[{kind: drop, from_s: 0.7, until_s: 1.0}]"});
  const Said expects = check("expects.mcap");
  EXPECT_EQ(expects.status, 0) << expects.out;
  EXPECT_THAT(expects.out, HasSubstr("expect    1 of 1 hold"));
  const Said data = check("expects.mcap", {"--data", "--json"});
  EXPECT_EQ(data.status, 1);
  const json found = json::parse(data.out);
  std::set<std::string> kinds;
  for (const json& f : found["findings"])
    if (f["topic"] == "/scanner/points") kinds.insert(f["kind"]);
  EXPECT_EQ(kinds, std::set<std::string>{"gap"}) << data.out;
  EXPECT_THAT(check("expects.mcap", {"--data", "--junit", file("j.xml")}).err, HasSubstr("--junit"));
  EXPECT_EQ(check("no-such.mcap").status, 2);
  EXPECT_EQ(rigor({"check", config("rigs/skid-steer.yaml")}).status, 2);
  // What is cut short is judged as far as it goes, and said.
  const std::string bytes = read_file(file("run.mcap"));
  write_file(file("cut.mcap"), bytes.substr(0, bytes.size() / 2));
  const Said cut = check("cut.mcap", {"--data"});
  EXPECT_EQ(cut.status, 1);
  EXPECT_THAT(cut.out, AllOf(HasSubstr("damage"), Not(HasSubstr("stamp_back"))));
}

}  // namespace
}  // namespace rigor::test
