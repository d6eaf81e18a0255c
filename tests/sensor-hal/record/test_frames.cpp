// The tree of frames, and what a recording tells of it: /tf_static first, /tf and /clock on their grid.
#include <unistd.h>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <numbers>

#include "sensor-hal/record/frame_tree.h"
#include "sensor-hal/record/recorder.h"
#include "sensor-hal/record/ros2_time.h"
#include "tests/sensor-hal/record/recording_fixture.h"

namespace rigor::record {
namespace {

using namespace test;
using testing::ElementsAre;
using testing::HasSubstr;
using Moves = FrameLink::Moves;

const double kHalf = std::sqrt(0.5);
/// A quarter turn to the left.
const std::array<double, 4> kLeft{kHalf, 0, 0, kHalf};

void expect_pose(const Pose& a, const Pose& b) {
  for (std::size_t i = 0; i < 3; ++i) EXPECT_NEAR(a.position_m[i], b.position_m[i], 1e-12) << i;
  double dot = 0;
  for (std::size_t i = 0; i < 4; ++i) dot += a.orientation_wxyz[i] * b.orientation_wxyz[i];
  EXPECT_NEAR(std::abs(dot), 1, 1e-12);
}

Pose pose_of(const msg::TransformStamped& t) {
  const auto& [p, q] = t.transform;
  return {{p.x, p.y, p.z}, {q.w, q.x, q.y, q.z}};
}

const msg::TransformStamped& of_child(const msg::TFMessage& m, const std::string& child) {
  for (const auto& t : m.transforms)
    if (t.child_frame_id == child) return t;
  throw std::runtime_error("no transform of " + child);
}

TEST(Frames, ArePutTogetherAlongTheTree) {
  const Pose T{{1, 2, 3}, kLeft};
  expect_pose(composed(T, inverse_of(T)), {});
  expect_pose(composed(T, {{1, 0, 0}, {1, 0, 0, 0}}), {{1, 3, 3}, kLeft});
  FrameTree tree;
  must(tree.add({.parent = "world", .child = "robot", .moves = Moves::with_body}));
  must(tree.add({.parent = "robot", .child = "mast", .T_parent_child = {{0, 0, 1}, kLeft}}));
  must(tree.add({.parent = "mast", .child = "scanner", .T_parent_child = {{0.5, 0, 0}, {1, 0, 0, 0}}}));
  must(tree.add({.parent = "robot", .child = "imu", .T_parent_child = {{0.1, 0, 0}, {1, 0, 0, 0}}}));
  const auto T_imu_scanner = tree.T_fixed("imu", "scanner");
  ASSERT_TRUE(T_imu_scanner);
  expect_pose(*T_imu_scanner, {{-0.1, 0.5, 1}, kLeft});
  expect_pose(*tree.T_fixed("scanner", "imu"), inverse_of(*T_imu_scanner));
  EXPECT_FALSE(tree.T_fixed("world", "scanner")) << "the robot moves";
  EXPECT_FALSE(tree.T_fixed("imu", "camera"));
}

TEST(Frames, HaveOneParentThatIsThere) {
  FrameTree tree("map");
  EXPECT_FALSE(tree.add({.parent = "world", .child = "a"}));
  must(tree.add({.parent = "map", .child = "a"}));
  EXPECT_FALSE(tree.add({.parent = "map", .child = "a"})) << "twice";
  EXPECT_FALSE(tree.add({.parent = "a", .child = "map"})) << "the root has none";
  EXPECT_FALSE(tree.add({.parent = "b", .child = "b"}));
}

/// REP 103: optical z forward, x right, y down; the body x forward, y left, z up.
TEST(Frames, OfCamerasHaveABodyWhoseXLooksForward) {
  FrameTree tree;
  // The camera at (0, 0, 2) looks along the world's y: its optical x is the world's x, its y the world's -z.
  const Pose T_world_optical{{0, 0, 2}, {kHalf, -kHalf, 0, 0}};
  must(tree.add_sensor({.parent = "world", .child = "left_optical", .T_parent_child = T_world_optical}));
  ASSERT_EQ(tree.links().size(), 2U);
  EXPECT_EQ(tree.links()[0].child, "left");
  EXPECT_EQ(tree.links()[1].parent, "left");
  expect_pose(*tree.T_fixed("world", "left_optical"), T_world_optical);
  // x of the body along the world's y, z up: a quarter turn to the left.
  expect_pose(*tree.T_fixed("world", "left"), {{0, 0, 2}, kLeft});
  // Where the body's name is taken, the optical frame stands alone.
  must(tree.add({.parent = "world", .child = "tof"}));
  must(tree.add_sensor({.parent = "world", .child = "tof_optical", .T_parent_child = T_world_optical}));
  EXPECT_EQ(tree.links().back().parent, "world");
}

FrameTree moving_tree() {
  FrameTree tree;
  must(tree.add({.parent = "world", .child = "robot", .moves = Moves::with_body, .index = 0}));
  must(tree.add({.parent = "robot",
                 .child = "boom",
                 .T_parent_child = {{1, 0, 0}, kLeft},
                 .moves = Moves::turns,
                 .index = 1,
                 .axis = {0, 0, 1}}));
  must(
      tree.add({.parent = "boom", .child = "slider", .moves = Moves::slides, .index = 0, .axis = {1, 0, 0}}));
  must(tree.add({.parent = "slider", .child = "lidar", .T_parent_child = {{0, 0, 0.5}, {1, 0, 0, 0}}}));
  FrameLink cart{.parent = "world", .child = "cart", .moves = Moves::by_itself};
  cart.way = [](Duration d) { return Pose{{2 * d.seconds(), 0, 0}, {1, 0, 0, 0}}; };
  must(tree.add(std::move(cart)));
  return tree;
}

WorldMotion motion_at(BenchTime t) {
  WorldMotion m;
  m.count = 2;
  m.joint[0] = {t, 0.25, 1};
  m.joint[1] = {t, std::numbers::pi / 2, 0};
  m.body_count = 1;
  m.body[0].t_ref = t;
  m.body[0].T_world_body = {{5, 6, 0}, {1, 0, 0, 0}};
  return m;
}

TEST(Frames, MoveWithBodiesJointsAndByThemselves) {
  const FrameTree tree = moving_tree();
  EXPECT_TRUE(tree.moves());
  const BenchTime t0(1'000'000'000), t = t0 + milliseconds(500);
  msg::TFMessage m;
  tree.moving(motion_at(t), t, t0, to_time(77), m);
  ASSERT_EQ(m.transforms.size(), 4U);
  EXPECT_EQ(m.transforms[0].header.stamp.nanosec, 77U);
  expect_pose(pose_of(of_child(m, "robot")), {{5, 6, 0}, {1, 0, 0, 0}});
  expect_pose(pose_of(of_child(m, "boom")), {{1, 0, 0}, {0, 0, 0, 1}});
  expect_pose(pose_of(of_child(m, "slider")), {{0.25, 0, 0}, {1, 0, 0, 0}});
  expect_pose(pose_of(of_child(m, "cart")), {{1, 0, 0}, {1, 0, 0, 0}});
  const msg::TFMessage fixed = tree.fixed(to_time(5));
  ASSERT_EQ(fixed.transforms.size(), 1U);
  EXPECT_EQ(fixed.transforms[0].header.frame_id, "slider");
}

struct Recorded {
  MemorySink memory;
  void run(RecorderOptions options, int cycles) {
    options.virtual_time = true;
    auto recorder =
        must(Recorder::create(std::make_unique<SharedSink>(memory), std::move(options), {}, {}, {}));
    recorder->begin(BenchTime(0));
    for (int k = 0; k < cycles; ++k) {
      const BenchTime t(k * 1'000'000);
      if (recorder->motion_due(t)) recorder->record_motion(motion_at(t), t);
      recorder->end_cycle(static_cast<std::uint64_t>(k), t);
    }
    must(recorder->stop());
  }
};

TEST(Frames, GoIntoARecordingStaticOnesFirstMovingOnesOnTheirGrid) {
  Recorded recorded;
  RecorderOptions options;
  options.frames = source_of(std::make_shared<const FrameTree>(moving_tree()));
  options.frames_period = Period::of_rate(50);
  options.clock = true;
  recorded.run(std::move(options), 101);
  auto reader = must(McapReader::open(memory_source(recorded.memory.bytes())));
  auto cursor = reader->messages({.order = MessageOrder::file});
  MessageView view;
  std::vector<std::string> first;
  std::vector<std::int64_t> clock_ns, tf_ns;
  while (must(cursor.next(view))) {
    if (first.size() < 3) first.push_back(view.channel->topic);
    if (view.channel->topic == "/tf_static") {
      EXPECT_THAT(view.channel->metadata.at("offered_qos_profiles"), HasSubstr("durability: 1"));
    }
    if (view.channel->topic == "/clock") {
      msg::Clock clock;
      must(CdrReader::read(view.data, clock));
      clock_ns.push_back(to_ns(clock.clock));
      EXPECT_EQ(static_cast<std::int64_t>(view.log_time_ns), clock_ns.back());
    }
    if (view.channel->topic == "/tf") {
      msg::TFMessage tf;
      must(CdrReader::read(view.data, tf));
      ASSERT_EQ(tf.transforms.size(), 4U);
      tf_ns.push_back(to_ns(tf.transforms[0].header.stamp));
    }
  }
  EXPECT_THAT(first, ElementsAre("/tf_static", "/clock", "/tf"));
  ASSERT_EQ(clock_ns.size(), 6U) << "0, 20, … 100 ms";
  EXPECT_EQ(clock_ns[5] - clock_ns[0], 100'000'000);
  EXPECT_EQ(tf_ns, clock_ns);
}

TEST(Frames, AreNotInARecordingThatHasNone) {
  Recorded recorded;
  recorded.run({}, 10);
  auto reader = must(McapReader::open(memory_source(recorded.memory.bytes())));
  for (const auto& [id, channel] : reader->channels())
    EXPECT_TRUE(channel.topic.starts_with("/rigor/")) << channel.topic;
}

TEST(Frames, OfARecordingComeBackInItsReplay) {
  Recorded recorded;
  RecorderOptions options;
  options.frames = source_of(std::make_shared<const FrameTree>(moving_tree()));
  options.frames_period = milliseconds(20);
  const Duration to_utc = options.epoch.utc - RealtimeTime(options.epoch.bench.ns());
  recorded.run(std::move(options), 101);
  const std::string path = testing::TempDir() + "rigor_frames_" + std::to_string(getpid()) + ".mcap";
  {
    auto sink = must(open_file_sink(path));
    const Bytes bytes(recorded.memory.bytes());
    must(sink->append(Pieces(&bytes, 1)));
  }
  auto frames = must(recorded_frames(path, to_utc));
  std::remove(path.c_str());
  ASSERT_TRUE(frames);
  EXPECT_TRUE(frames->moves());
  EXPECT_EQ(frames->fixed(to_time(9)).transforms.size(), 1U);
  msg::TFMessage m;
  EXPECT_TRUE(frames->moving({}, BenchTime(45'000'000), BenchTime(0), {}, m));
  EXPECT_EQ(to_ns(m.transforms[0].header.stamp) - to_utc.ns(), 40'000'000) << "the newest by then";
  EXPECT_FALSE(frames->moving({}, BenchTime(55'000'000), BenchTime(0), {}, m)) << "nothing new";
  EXPECT_TRUE(frames->moving({}, BenchTime(60'000'000), BenchTime(0), {}, m));
}

}  // namespace
}  // namespace rigor::record
