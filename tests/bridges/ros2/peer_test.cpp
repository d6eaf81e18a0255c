// The bridge against another implementation of DDS: Fast DDS, in a process of its own (fastdds_peer.cpp), and
// Wireshark's dissector over what went between them. Runs begin when both sides have found each other.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>

#include <atomic>
#include <cstdlib>
#include <sstream>
#include <thread>

#include "bench/bench.h"
#include "builtin/registry.h"
#include "tests/bridges/ros2/made_samples.h"
#include "tests/bridges/ros2/network.h"
#include "tests/cli/command.h"

namespace rigor::test {
namespace {

using ::testing::Contains;
using ::testing::HasSubstr;
using ::testing::StartsWith;

/// On the machine's own loopback Fast DDS has to be told to use it, as ROS_LOCALHOST_ONLY=1 does.
constexpr const char* kLoopbackProfile = R"(<?xml version="1.0" encoding="UTF-8"?>
<dds xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles"><profiles>
  <transport_descriptors><transport_descriptor>
    <transport_id>loopback</transport_id><type>UDPv4</type>
    <interfaceWhiteList><address>127.0.0.1</address></interfaceWhiteList>
  </transport_descriptor></transport_descriptors>
  <participant profile_name="loopback" is_default_profile="true"><rtps>
    <userTransports><transport_id>loopback</transport_id></userTransports>
    <useBuiltinTransports>false</useBuiltinTransports>
  </rtps></participant>
</profiles></dds>
)";

struct PeerTest : ::testing::Test {
  TempDir dir;
  std::uint32_t domain = free_domain();

  PeerTest() {
    write_file(dir / "loopback.xml", kLoopbackProfile);
    setenv("FASTRTPS_DEFAULT_PROFILES_FILE", (dir / "loopback.xml").c_str(), 1);
    setenv("FASTDDS_PEER_GO", (dir / "go").c_str(), 1);
  }
  /// Its standard input is a pipe that stays open and empty.
  std::unique_ptr<Command> peer(const std::string& mode, const std::string& qos, int count,
                                const std::vector<std::string>& topics) {
    const std::string pipe = (dir / ("input" + std::to_string(++peers_))).string();
    std::string words = "mkfifo " + pipe + " && exec " RIGOR_FASTDDS_PEER " " + mode + " " +
                        std::to_string(domain) + " " + qos + " " + std::to_string(count);
    for (const std::string& t : topics) words += " " + t;
    words += " 0<>" + pipe;
    return std::make_unique<Command>(std::vector<std::string>{"bash", "-c", words});
  }
  static std::vector<std::string> lines(const Command& command) {
    std::vector<std::string> all;
    std::istringstream text(command.out());
    for (std::string line; std::getline(text, line);) all.push_back(line);
    return all;
  }
  static std::size_t count(const std::vector<std::string>& all, const std::string& start) {
    return static_cast<std::size_t>(
        std::ranges::count_if(all, [&](const std::string& l) { return l.starts_with(start); }));
  }
  /// Until so many lines begin with `start`, at most half a minute.
  static bool says(const Command& command, const std::string& start, std::size_t times = 1) {
    for (int i = 0; i < 6000; ++i) {
      if (count(lines(command), start) >= times) return true;
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
    }
    return false;
  }
  std::unique_ptr<Bench> prepared(const std::string& rig, BenchOptions options = {}) {
    write_file(dir / "rig.yaml", "name: bridged\n" + rig);
    auto loaded = load_rig(dir / "rig.yaml", {});
    EXPECT_TRUE(loaded) << loaded.error().text();
    Registry registry = make_registry();
    registry.add(made_backend());
    auto bench = Bench::create(*loaded, registry, std::move(options));
    EXPECT_TRUE(bench) << bench.error().text();
    const auto ready = (*bench)->prepare();
    EXPECT_TRUE(ready) << ready.error().text();
    return std::move(*bench);
  }
  std::string bridge(const std::string& keys) const {
    return "bridges:\n  ros2:\n    domain: " + std::to_string(domain) + "\n" + keys;
  }

 private:
  int peers_ = 0;
};

std::uint64_t digest(std::span<const std::uint8_t> bytes) {
  std::uint64_t hash = 14695981039346656037u;
  for (const std::uint8_t b : bytes) hash = (hash ^ b) * 1099511628211u;
  return hash;
}

constexpr const char* kSensors = R"(clock: virtual
loop: { rate_hz: 1000 }
channels:
  left: { kind: image, backend: made, rate_hz: 10, width_px: 1280, height_px: 1024 }
  top: { kind: point_cloud, backend: made, rate_hz: 10, point_count: 20000 }
  imu: { kind: imu, backend: made, rate_hz: 100 }
)";

/// Reliable, so that each sample comes, and paced, so that the reader keeps up.
TEST_F(PeerTest, FastDdsReadsPicturesCloudsAndInertialSamplesWhole) {
  auto reader = peer("read", "reliable", 20,
                     {"/left/image", "sensor_msgs/Image", "/top/points", "sensor_msgs/PointCloud2",
                      "/imu/imu", "sensor_msgs/Imu"});
  BenchOptions options;
  options.pace = 1;
  auto bench = prepared(std::string(kSensors) + "duration_s: 2\n" +
                            bridge("    wait_for: [/left/image, /top/points, /imu/imu]\n"),
                        options);
  ASSERT_TRUE(says(*reader, "matched", 3)) << reader->out() << reader->err();
  const auto report = bench->run();
  ASSERT_TRUE(report) << report.error().text();
  const RunBridgeReport& b = report->bridges[0];
  std::map<std::string, BridgeReport::Topic> topics;
  for (const auto& t : b.traffic.topics) topics[t.topic] = t;
  const Said said = reader->wait();
  EXPECT_EQ(said.status, 0) << said.out << said.err;
  const auto all = lines(*reader);
  // All that was accepted came, in order and whole.
  EXPECT_EQ(count(all, "image /left/image"), topics["/left/image"].accepted);
  EXPECT_EQ(topics["/left/image"].messages, 20u);
  EXPECT_EQ(topics["/left/image"].accepted + topics["/left/image"].dropped, 20u);
  EXPECT_EQ(topics["/left/image"].dropped, 0u);
  std::vector<std::uint8_t> pixels(1280 * 1024);
  for (std::uint64_t n = 0; n < 20; ++n) {
    for (std::size_t y = 0; y < 1024; ++y)
      std::memset(pixels.data() + y * 1280, MadeSource::pixel(n, y), 1280);
    char line[200];
    std::snprintf(
        line, sizeof line, "image /left/image %d.%09d left_frame 1280x1024 mono8 1280 1310720 %016lx",
        static_cast<int>(1577836800 + n / 10), static_cast<int>(n % 10) * 100'000'000, digest(pixels));
    EXPECT_THAT(all, Contains(std::string(line)));
  }
  EXPECT_EQ(count(all, "cloud /top/points"), 20u);
  EXPECT_THAT(
      all,
      Contains(HasSubstr("top_frame 20000 x,y,z,intensity,t_offset_ns,ring,return_index,flags 24 480000")));
  EXPECT_THAT(all, Contains("imu /imu/imu 1577836800.190000000 imu_frame 0.1 0.2 0.19 19 0 9.81"));
  // Discovery said which definitions are meant.
  EXPECT_THAT(all,
              Contains("hash rt/left/image "
                       "typehash=RIHS01_d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47;"));
  EXPECT_THAT(all,
              Contains("hash rt/top/points "
                       "typehash=RIHS01_9198cabf7da3796ae6fe19c4cb3bdd3525492988c70522628af5daa124bae2b5;"));
}

TEST_F(PeerTest, CommandsOfFastDdsReachTheirSink) {
  auto writer = peer("write", "reliable", 50, {"/cmd_vel", "geometry_msgs/Twist"});
  auto bench = prepared("clock: virtual\nduration_s: 1000\nloop: { rate_hz: 1000 }\n" +
                        bridge(R"(    wait_for: [/cmd_vel]
    commands:
      /cmd_vel: { type: geometry_msgs/Twist, sink: drive, values: { speed: linear.x, turn: angular.z } }
)") + "sinks:\n  drive: { backend: log, signals: [speed, turn] }\n");
  ASSERT_TRUE(bench->start());
  ASSERT_TRUE(says(*writer, "matched"));
  write_file(dir / "go", "");
  ASSERT_TRUE(says(*writer, "sent")) << writer->out() << writer->err();
  EXPECT_THAT(lines(*writer), Contains("sent 50 acknowledged"));
  ASSERT_TRUE(*bench->step(100));
  const auto report = bench->finish();
  ASSERT_TRUE(report) << report.error().text();
  const auto& c = report->bridges[0].traffic.commands[0];
  EXPECT_EQ(c.received, 50u);
  EXPECT_EQ(c.accepted + c.superseded + c.dropped, 50u);
  EXPECT_EQ(c.rejected, 0u);
  EXPECT_EQ(report->sinks[0].commands.accepted, c.accepted);
  EXPECT_GE(c.accepted, 1u);
}

TEST_F(PeerTest, ATopicOfFastDdsIsAChannel) {
  write_file(dir / "go", "");
  auto writer = peer("write", "best_effort", 1000000, {"/imu/data", "sensor_msgs/Imu"});
  auto bench = prepared(
      "clock: wall\nduration_s: 3\nloop: { rate_hz: 200, fifo_priority: 0, lock_memory: false, "
      "dma_latency: false }\nchannels:\n  imu: { kind: imu, backend: ros2, topic: /imu/data, rate_hz: 100, "
      "latency_ms: 30, domain: " +
      std::to_string(domain) + " }\n");
  ASSERT_TRUE(says(*writer, "matched"));
  const auto report = bench->run();
  ASSERT_TRUE(report) << report.error().text();
  EXPECT_GT(report->facts.channels[0].delivered, 20u)
      << "of 300, less what was sent before the source had found the writer";
  EXPECT_EQ(report->channels[0].health.protocol_errors, 0u);
  EXPECT_EQ(report->channels[0].port.lost_samples, 0u);
  EXPECT_LT(report->channels[0].arrival.percentile(0.5), milliseconds(20))
      << "the header's stamps are believed";
}

/// A peer that acknowledges and is stopped: the run goes on as if it were not there, and what DDS did not
/// take is in the account.
TEST_F(PeerTest, APeerThatStandsStillCostsCountedMessagesAndNoCycle) {
  auto reader = peer("read", "reliable", 1000000, {"/left/image", "sensor_msgs/Image"});
  auto bench = prepared(
      "clock: wall\nduration_s: 2\nloop: { rate_hz: 200, fifo_priority: 0, lock_memory: false, dma_latency: "
      "false }\nchannels:\n"
      "  left: { kind: image, backend: made, rate_hz: 50, width_px: 640, height_px: 480 }\n  table: { kind: "
      "registers, backend: made, rate_hz: 200 }\n" +
      bridge("    wait_for: [/left/image]\n"));
  ASSERT_TRUE(says(*reader, "matched"));
  std::thread stopper([&] {
    EXPECT_TRUE(holds_soon([&] { return bench->cycle() >= 60; })) << "the run did not get so far";
    reader->signal(SIGSTOP);
  });
  const auto report = bench->run();
  stopper.join();
  ASSERT_TRUE(report) << report.error().text();
  EXPECT_EQ(report->outcome.loop.reason, StopReason::finished);
  const RunBridgeReport& b = report->bridges[0];
  std::uint64_t dropped = 0, images = 0;
  for (const auto& t : b.traffic.topics) {
    EXPECT_EQ(t.accepted + t.dropped, t.messages) << t.topic;
    if (t.topic == "/left/image")
      images = t.messages, dropped = t.dropped;
    else
      EXPECT_EQ(t.dropped, 0u) << t.topic << " has no peer that stands still";
  }
  EXPECT_GT(dropped, 20u);
  // Each sample of the loop is in the account once.
  for (std::size_t i = 0; i < report->channels.size(); ++i)
    EXPECT_EQ(b.channels[i].samples + b.channels[i].dropped, report->channels[i].taken) << b.channels[i].name;
  EXPECT_EQ(b.channels[0].samples, images);
  EXPECT_EQ(report->channels[0].health.no_slot, 0u)
      << "the slots that DDS holds are not missing to the source";
  EXPECT_THAT(report->text(), HasSubstr("were dropped, because a peer or the network did not keep up"));
  const auto all = lines(*reader);
  EXPECT_LE(count(all, "image /left/image"), images - dropped);
}

TEST_F(PeerTest, WiresharkFindsNothingMalformed) {
  if (std::system("command -v tshark >/dev/null 2>&1") != 0) GTEST_SKIP() << "tshark is not installed";
  const std::filesystem::path capture = dir / "rtps.pcapng";
  Command tshark({"tshark", "-q", "-i", "lo", "-f", "udp", "-w", capture.string()});
  bool listens = false;
  for (int i = 0; i < 2000 && tshark.running() && !listens; ++i) {
    listens = tshark.err().find("Capturing on") != std::string::npos && std::filesystem::exists(capture) &&
              std::filesystem::file_size(capture) > 0;
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  }
  if (!tshark.running()) {
    const std::string why = tshark.err();
    if (why.find("ermission") != std::string::npos || why.find("not permitted") != std::string::npos)
      GTEST_SKIP() << "this user may not capture on lo here: " << why;
    FAIL() << "tshark ended before it captured: " << why;
  }
  ASSERT_TRUE(listens) << tshark.err();
  auto reader =
      peer("read", "reliable", 5, {"/left/image", "sensor_msgs/Image", "/imu/imu", "sensor_msgs/Imu"});
  auto writer = peer("write", "reliable", 20, {"/cmd_vel", "geometry_msgs/Twist"});
  BenchOptions options;
  options.pace = 1;
  auto bench = prepared(R"(clock: virtual
loop: { rate_hz: 1000 }
duration_s: 1
channels:
  left: { kind: image, backend: made, rate_hz: 10, width_px: 640, height_px: 480 }
  imu: { kind: imu, backend: made, rate_hz: 100 }
)" + bridge(R"(    wait_for: [/left/image, /imu/imu, /cmd_vel]
    commands:
      /cmd_vel: { type: geometry_msgs/Twist, sink: drive, values: { speed: linear.x, turn: angular.z } }
)") + "sinks:\n  drive: { backend: log, signals: [speed, turn] }\n",
                        options);
  ASSERT_TRUE(says(*reader, "matched", 2));
  ASSERT_TRUE(says(*writer, "matched"));
  write_file(dir / "go", "");
  const auto report = bench->run();
  ASSERT_TRUE(report) << report.error().text();
  EXPECT_EQ(reader->wait().status, 0);
  ASSERT_TRUE(says(*writer, "sent 20"));
  EXPECT_GT(report->bridges[0].traffic.commands[0].received, 0u);
  tshark.signal(SIGINT);
  tshark.wait();

  const auto dissected = [&](const std::string& filter) {
    Command reading({"tshark", "-r", capture.string(), "-Y", filter, "-T", "fields", "-e", "frame.number",
                     "-e", "_ws.expert.message"});
    const Said said = reading.wait();
    EXPECT_EQ(said.status, 0) << said.err;
    return said.out;
  };
  EXPECT_EQ(dissected("_ws.malformed"), "");
  EXPECT_EQ(dissected("rtps && _ws.expert.severity >= 8388608"), "") << "errors of the dissector";
  const std::string data = dissected("rtps.sm.id == 0x15 || rtps.sm.id == 0x16");
  EXPECT_GT(std::ranges::count(data, '\n'), 200) << "data and fragments of pictures";
  EXPECT_THAT(dissected("rtps.param.topicName == \"rt/left/image\""), ::testing::Not(""));
  EXPECT_THAT(dissected("rtps.param.typeName == \"sensor_msgs::msg::dds_::Image_\""), ::testing::Not(""));
  EXPECT_THAT(dissected("rtps.param.typeName == \"geometry_msgs::msg::dds_::Twist_\""), ::testing::Not(""));
}

}  // namespace
}  // namespace rigor::test
