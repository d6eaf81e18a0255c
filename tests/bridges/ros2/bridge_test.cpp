// Runs with a bridge to ROS 2, in virtual time, with the other side in this process.
#include <dds/dds.h>
#include <gmock/gmock.h>

#include <cstring>
#include <thread>

#include "bench/bench.h"
#include "bridges/ros2/definition.h"
#include "bridges/ros2/names.h"
#include "bridges/ros2/participant.h"
#include "bridges/ros2/payload.h"
#include "builtin/registry.h"
#include "sensor-hal/record/cdr.h"
#include "sensor-hal/record/mcap_reader.h"
#include "sensor-hal/record/ros2_messages.h"
#include "tests/bridges/ros2/made_samples.h"
#include "tests/bridges/ros2/network.h"
#include "tests/cli/command.h"

namespace rigor::test {
namespace {

using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using namespace ros2;

const char* const kAllKinds = R"(
channels:
  left: { kind: image, backend: made, rate_hz: 20, width_px: 320, height_px: 200 }
  depth: { kind: range_image, backend: made, rate_hz: 10 }
  top: { kind: point_cloud, backend: made, rate_hz: 10, latency_ms: 30 }
  bus: { kind: can_frame, backend: made, rate_hz: 100 }
  turntable: { kind: registers, backend: made, rate_hz: 100 }
  truth: { kind: pose, backend: made, rate_hz: 50 }
  imu: { kind: imu, backend: made, rate_hz: 100 }
  gnss: { kind: nav_fix, backend: made, rate_hz: 10 }
  wheels: { kind: odometry, backend: made, rate_hz: 50 }
)";

struct BridgeTest : ::testing::Test {
  TempDir dir;
  std::uint32_t domain = free_domain();
  std::shared_ptr<Participant> peer = *Participant::open({.domain = domain});

  Result<std::unique_ptr<Bench>> create(const std::string& more, const std::string& duration = "1") {
    const std::filesystem::path file = dir / "rig.yaml";
    write_file(file, "name: bridged\nclock: virtual\nduration_s: " + duration +
                         "\nloop: { rate_hz: 1000 }\n" + more);
    auto rig = load_rig(file, {});
    if (!rig) return tl::unexpected<Error>(rig.error());
    Registry registry = make_registry();
    registry.add(made_backend());
    BenchOptions options;
    options.replace = true;
    return Bench::create(*rig, registry, std::move(options));
  }
  std::unique_ptr<Bench> prepared(const std::string& more, const std::string& duration = "1") {
    auto bench = create(more, duration);
    EXPECT_TRUE(bench) << bench.error().text();
    const auto ready = (*bench)->prepare();
    EXPECT_TRUE(ready) << ready.error().text();
    return std::move(*bench);
  }
  std::string bridge(const std::string& keys) const {
    return "bridges:\n  ros2:\n    domain: " + std::to_string(domain) + "\n" + keys;
  }
  std::unique_ptr<Reader> read(const std::string& topic, const std::string& type,
                               Qos qos = {Qos::Profile::reliable, 5000}) {
    auto reader = peer->read(topic, {full_type(type), definition_text(type)}, qos);
    EXPECT_TRUE(reader) << reader.error().text();
    return std::move(*reader);
  }
  std::unique_ptr<Writer> write(const std::string& topic, const std::string& type) {
    auto writer = peer->write(topic, {full_type(type), definition_text(type)}, {Qos::Profile::reliable, 0});
    EXPECT_TRUE(writer) << writer.error().text();
    return std::move(*writer);
  }
  template <class M>
  static void send(Writer& writer, const M& message) {
    record::CdrWriter cdr;
    const auto pieces = cdr.write(message);
    ASSERT_TRUE(pieces);
    ASSERT_TRUE(writer.send(make_message(writer.type(), *pieces, {}, {})));
  }
  static std::vector<std::vector<std::byte>> all_of(Reader& reader) {
    std::vector<std::vector<std::byte>> messages;
    std::vector<std::byte> joined;
    while (ddsi_serdata* message = reader.take()) {
      const auto bytes = bytes_of(message, joined);
      messages.emplace_back(bytes.begin(), bytes.end());
      Reader::release(message);
    }
    return messages;
  }
};

TEST_F(BridgeTest, WhatLeavesIsTheRecordingByteForByte) {
  const std::string record = "record: { file: " + (dir / "run.mcap").string() + " }\n";
  {
    auto bench = prepared(kAllKinds + record);
    const auto report = bench->run();
    ASSERT_TRUE(report) << report.error().text();
  }
  std::map<std::string, std::vector<std::vector<std::byte>>> recorded;
  std::map<std::string, std::string> types;
  auto file = record::McapReader::open((dir / "run.mcap").string());
  ASSERT_TRUE(file);
  for (const auto& [id, channel] : (*file)->channels()) {
    recorded[channel.topic];
    types[channel.topic] = (*file)->schemas().at(channel.schema).name;
  }
  auto cursor = (*file)->messages({.order = record::MessageOrder::file});
  record::MessageView view;
  while (*cursor.next(view)) recorded[view.channel->topic].emplace_back(view.data.begin(), view.data.end());
  ASSERT_GE(recorded.size(), 20u);

  std::map<std::string, std::unique_ptr<Reader>> readers;
  for (const auto& [topic, type] : types) readers[topic] = read(topic, type);
  auto bench = prepared(kAllKinds + bridge(""));
  const auto report = bench->run();
  ASSERT_TRUE(report) << report.error().text();
  std::size_t messages = 0;
  for (const auto& [topic, expected] : recorded) {
    const auto got = all_of(*readers[topic]);
    EXPECT_EQ(got.size(), expected.size()) << topic;
    EXPECT_TRUE(got == expected) << topic << ", a " << types[topic];
    messages += got.size();
  }
  EXPECT_GT(messages, 900u);

  // And each is in the account once.
  ASSERT_EQ(report->bridges.size(), 1u);
  const RunBridgeReport& b = report->bridges[0];
  EXPECT_EQ(b.messages(), messages);
  EXPECT_EQ(b.dropped, 0u);
  for (const auto& t : b.traffic.topics) {
    EXPECT_EQ(t.messages, recorded[t.topic].size()) << t.topic;
    EXPECT_EQ(t.accepted + t.dropped, t.messages) << t.topic;
    EXPECT_EQ(t.dropped, 0u) << t.topic;
  }
  for (std::size_t i = 0; i < report->channels.size(); ++i)
    EXPECT_EQ(b.channels[i].samples + b.channels[i].dropped,
              report->channels[i].taken - (report->channels[i].name == "top" ? b.after_end : 0))
        << report->channels[i].name;
}

TEST_F(BridgeTest, ChosenChannelsAndTopicsLeaveUnderTheirPrefix) {
  auto bench = prepared(kAllKinds + bridge(R"(    namespace: /rig1
    channels: [imu, left]
    topics:
      "/imu/*": { qos: sensor_data, depth: 3 }
      "*/stamp": { send: false }
      "/rigor/*": { send: false }
)"));
  const auto report = bench->run();
  ASSERT_TRUE(report) << report.error().text();
  std::map<std::string, std::string> qos;
  for (const auto& t : report->bridges[0].traffic.topics) qos[t.topic] = t.qos;
  EXPECT_THAT(qos, ElementsAre(std::pair("/clock", "reliable"), std::pair("/rig1/imu/imu", "sensor_data(3)"),
                               std::pair("/rig1/imu/imu/temperature", "sensor_data(3)"),
                               std::pair("/rig1/left/image", "reliable"),
                               std::pair("/rig1/left/image/settings", "reliable"),
                               std::pair("/tf_static", "transient_local")));
}

TEST_F(BridgeTest, CommandsComeToTheirSinks) {
  const auto commands = read("/rigor/commands", "rigor_msgs/Command");
  const auto twist = write("/cmd_vel", "geometry_msgs/Twist");
  const auto joints = write("/joints", "sensor_msgs/JointState");
  auto bench = prepared(bridge(R"(    wait_for: [/cmd_vel, /joints]
    commands:
      /cmd_vel:
        type: geometry_msgs/Twist
        sink: drive
        values: { speed: linear.x, turn: angular.z, gear: 3 }
        scale: { turn: 10 }
        limits: { speed: [-2, 2] }
      /joints: { type: sensor_msgs/JointState, sink: arm, beyond: clamp, limits: { elbow: [-1, 1] } }
)") + "sinks:\n  drive: { backend: log, signals: [speed, turn, gear] }\n  arm: { backend: log, signals: "
      "[elbow, wrist] }\n",
                        "1000");
  ASSERT_TRUE(bench->start());
  record::msg::Command command;
  /// Steps until a command leaves; the test's own time limit is that of its run.
  const auto next = [&]() -> const record::msg::Command& {
    command = {};
    std::vector<std::byte> joined;
    for (int i = 0; i < 20000; ++i) {
      const auto more = bench->step(1);
      EXPECT_TRUE(more && *more);
      if (ddsi_serdata* message = commands->take()) {
        EXPECT_TRUE(record::CdrReader::read(bytes_of(message, joined), command));
        Reader::release(message);
        return command;
      }
      std::this_thread::yield();
    }
    ADD_FAILURE() << "no command came";
    return command;
  };
  send(*twist, record::msg::Twist{{1.5, 0, 0}, {0, 0, -0.25}});
  EXPECT_THAT(next().values, ElementsAre(1.5, -2.5, 3));
  EXPECT_EQ(command.channel, "drive");
  send(*joints, record::msg::JointState{{}, {"wrist", "elbow"}, {0.5, 7}, {}, {}});
  EXPECT_THAT(next().values, ElementsAre(1, 0.5));
  EXPECT_EQ(command.channel, "arm");
  // None of these may reach the sink: beyond a limit, no number, a joint that is missing.
  send(*twist, record::msg::Twist{{2.5, 0, 0}, {}});
  send(*twist, record::msg::Twist{{std::numeric_limits<double>::quiet_NaN(), 0, 0}, {}});
  send(*twist, record::msg::Twist{{0, 0, 0}, {0, 0, std::numeric_limits<double>::infinity()}});
  send(*joints, record::msg::JointState{{}, {"elbow"}, {0.1}, {}, {}});
  send(*joints, record::msg::JointState{{}, {"elbow", "wrist"}, {0.25, 0.75}, {}, {}});
  EXPECT_THAT(next().values, ElementsAre(0.25, 0.75))
      << "messages of a topic come in order, so the others were looked at";
  send(*twist, record::msg::Twist{{0.125, 0, 0}, {}});
  EXPECT_THAT(next().values, ElementsAre(0.125, 0, 3));
  const auto report = bench->finish();
  ASSERT_TRUE(report) << report.error().text();
  const auto& drive = report->bridges[0].traffic.commands[0];
  EXPECT_EQ(drive.received, 5u);
  EXPECT_EQ(drive.accepted, 2u);
  EXPECT_EQ(drive.rejected, 3u);
  EXPECT_THAT(drive.last_rejection, HasSubstr("expected a finite number for turn"));
  const auto& arm = report->bridges[0].traffic.commands[1];
  EXPECT_EQ(arm.accepted, 2u);
  EXPECT_EQ(arm.clamped, 1u);
  EXPECT_EQ(arm.rejected, 1u);
  EXPECT_THAT(arm.last_rejection, HasSubstr("expected position.wrist in the message, found none"));
  EXPECT_THAT(report->text(), HasSubstr("8 commands, 4 given, 4 rejected"));
  EXPECT_TRUE(report->verdict
                  .found([] {
                    FindingSet set;
                    set.add(FindingKind::bridge);
                    return set;
                  }())
                  .has(FindingKind::bridge));
}

TEST_F(BridgeTest, AProgramThatFallsSilentCostsTheValuesOfTheTimeout) {
  const auto commands = read("/rigor/commands", "rigor_msgs/Command");
  const auto speed = write("/speed", "std_msgs/Float64");
  auto bench = prepared(bridge(R"(    wait_for: [/speed]
    commands:
      /speed: { type: std_msgs/Float64, sink: drive, timeout_ms: 200, on_timeout: { speed: 0.5 }, limits: { speed: [0.5, 3] } }
)") + "sinks:\n  drive: { backend: log, signals: [speed] }\n",
                        "1000");
  ASSERT_TRUE(bench->start());
  struct Float64 {
    double data;
    static constexpr auto fields() { return std::tuple(&Float64::data); }
  };
  std::vector<std::pair<double, double>> given;  // value, seconds of bench time
  const auto look = [&] {
    for (const auto& bytes : all_of(*commands)) {
      record::msg::Command command;
      ASSERT_TRUE(record::CdrReader::read(bytes, command));
      given.emplace_back(command.values[0],
                         static_cast<double>(command.header.stamp.nanosec) * 1e-9 + command.header.stamp.sec);
    }
  };
  send(*speed, Float64{2});
  for (int i = 0; given.empty() && i < 20000; ++i, look(), std::this_thread::yield())
    ASSERT_TRUE(*bench->step(1));
  ASSERT_TRUE(*bench->step(1000));
  look();
  ASSERT_EQ(given.size(), 2u) << "one command, and one timeout";
  EXPECT_EQ(given[0].first, 2);
  EXPECT_EQ(given[1].first, 0.5);
  EXPECT_NEAR(given[1].second - given[0].second, 0.2, 1.5e-3);
  const auto report = bench->finish();
  ASSERT_TRUE(report);
  EXPECT_EQ(report->bridges[0].traffic.commands[0].timeouts, 1u);
}

TEST_F(BridgeTest, PeersThatCannotBeMatchedAreToldInASentence) {
  const auto strict = read("/imu/imu", "sensor_msgs/Imu", {Qos::Profile::reliable, 0});
  const auto late =
      read("/turntable/registers", "rigor_msgs/RegisterBlock", {Qos::Profile::transient_local, 0});
  const auto other = read("/truth/pose", "geometry_msgs/TwistStamped", {Qos::Profile::sensor_data, 0});
  auto bench = prepared(kAllKinds + bridge("    topics: { /imu/*: { qos: sensor_data } }\n"));
  const auto report = bench->run();
  ASSERT_TRUE(report) << report.error().text();
  const auto& problems = report->bridges[0].traffic.problems;
  EXPECT_THAT(problems,
              Contains(HasSubstr("/imu/imu: 1 of 1 subscribers asked for another RELIABILITY than it offers "
                                 "(best effort); set `topics: { /imu/imu: { qos: reliable } }`")));
  EXPECT_THAT(problems, Contains(HasSubstr("/turntable/registers: 1 of 1 subscribers asked for another "
                                           "DURABILITY than it offers (volatile)")));
  EXPECT_THAT(problems, Contains(HasSubstr(
                            "/truth/pose: a subscriber takes it for geometry_msgs::msg::dds_::TwistStamped_, "
                            "here it is geometry_msgs::msg::dds_::PoseStamped_: the topic is inconsistent")));
  EXPECT_THAT(report->text(), HasSubstr("warning bridge ros2: /imu/imu"));
  EXPECT_EQ(all_of(*strict).size(), 0u);
}

TEST_F(BridgeTest, ARunThatWaitsForAPeerThatDoesNotComeSaysSo) {
  auto bench = create(kAllKinds + bridge("    wait_for: [/left/image]\n    wait_s: 0.05\n"));
  ASSERT_TRUE(bench) << bench.error().text();
  const auto ready = (*bench)->prepare();
  ASSERT_FALSE(ready);
  EXPECT_EQ(ready.error().code, ErrorCode::timeout);
  EXPECT_THAT(ready.error().text(),
              HasSubstr("rig.yaml:19:16: expected a peer of /left/image within 0.05 s, got none"));
}

TEST_F(BridgeTest, MistakesAreRefusedWhereTheyAre) {
  const std::string sinks = "sinks:\n  drive: { backend: log, signals: [speed, turn] }\n";
  const auto said = [&](const std::string& keys) {
    const auto bench = create(sinks + keys);
    return bench ? std::string("accepted") : bench.error().text();
  };
  // Lines 1 to 4 are the rig's, 5 and 6 the sinks.
  EXPECT_THAT(
      said("bridges: { ros3: {} }\n"),
      HasSubstr("rig.yaml:7:18: bridges.ros3: expected one of ros2, got \"ros3\"; did you mean ros2?"));
  EXPECT_THAT(said("bridges: { ros2: { domian: 1 } }\n"),
              HasSubstr("rig.yaml:7:20: bridges.ros2.domian: unknown key; did you mean domain?"));
  EXPECT_THAT(
      said("bridges: { ros2: { domain: 233 } }\n"),
      HasSubstr("rig.yaml:7:28: bridges.ros2.domain: expected a whole number from 0 to 232, got 233"));
  EXPECT_THAT(said("bridges: { ros2: { qos: best_effort } }\n"),
              HasSubstr("expected one of sensor_data, reliable, transient_local, got best_effort"));
  EXPECT_THAT(said("bridges: { ros2: { channels: [lefft] } }\n"),
              HasSubstr("expected a channel of the rig, one of none, got \"lefft\""));
  EXPECT_THAT(said("bridges: { ros2: { namespace: \"/a-b\" } }\n"), HasSubstr("expected a topic of ROS 2"));
  const auto command = [&](const std::string& keys) {
    return said("bridges: { ros2: { commands: { /cmd_vel: { " + keys + " } } } }\n");
  };
  EXPECT_THAT(command("type: geometry_msgs/Twist, sink: drve"),
              HasSubstr("expected a sink of the rig, one of drive, got \"drve\"; did you mean drive?"));
  EXPECT_THAT(command("type: geometry_msgs/Twits, sink: drive"),
              HasSubstr("did you mean geometry_msgs/Twist?"));
  EXPECT_THAT(
      command("type: geometry_msgs/Twist, sink: drive"),
      HasSubstr("expected a number of geometry_msgs/msg/Twist for each value of drive (speed), got nothing"));
  EXPECT_THAT(command("type: geometry_msgs/Twist, sink: drive, values: { speed: linear.x }"),
              HasSubstr("expected all values of drive, found none for turn"));
  EXPECT_THAT(command("type: geometry_msgs/Twist, sink: drive, values: { speed: linear.w, turn: 0 }"),
              HasSubstr("expected a number of geometry_msgs/msg/Twist, one of linear.x"));
  EXPECT_THAT(command("type: geometry_msgs/Twist, sink: drive, values: { spead: linear.x }"),
              HasSubstr("did you mean speed?"));
  EXPECT_THAT(command("type: std_msgs/Float64MultiArray, sink: drive, limits: { turn: [2, 1] }"),
              HasSubstr("expected the lower limit first"));
  EXPECT_THAT(command("type: std_msgs/Float64MultiArray, sink: drive, on_timeout: { turn: 1 }"),
              HasSubstr("expected `timeout_ms` with it"));
  EXPECT_THAT(
      command("type: std_msgs/Float64MultiArray, sink: drive, timeout_ms: 100, limits: { turn: [1, 2] }"),
      HasSubstr("0 is beyond them"));
  EXPECT_THAT(command("type: std_msgs/Float64MultiArray, sink: drive"), "accepted");
}

TEST_F(BridgeTest, InVirtualTimeARunIsTheSameWithAndWithoutABridge) {
  const auto digest = [&](const std::string& more) {
    auto bench = prepared(kAllKinds + more);
    const auto report = bench->run();
    EXPECT_TRUE(report) << report.error().text();
    return report->outcome.input_sha256;
  };
  const auto reader = read("/left/image", "sensor_msgs/Image");  // keeps all that it gets
  const std::string plain = digest("");
  EXPECT_FALSE(plain.empty());
  EXPECT_EQ(digest(bridge("")), plain);
}

}  // namespace
}  // namespace rigor::test
