// What the emulated Ouster sends and when, and what its source makes of losses, of ends of recordings and of
// sensors that are not the expected one.
#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <atomic>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <optional>
#include <set>
#include <thread>

#include "drivers/network/udp_receiver.h"
#include "drivers/network/udp_sender.h"
#include "drivers/ouster/ouster_source.h"
#include "drivers/ouster/pcap_report.h"
#include "rt-core/file_descriptor.h"
#include "tests/drivers/ouster/ouster_device.h"
#include "tests/drivers/ouster/record_sensor.h"
#include "tests/eventually.h"

namespace rigor::ouster {
namespace {

using packet_lidar::test::poll_until;
using packet_lidar::test::run_virtual;
using test::config_of;
using test::Device;

/// Datagrams at a port until `take` has enough, or half a minute has passed.
template <class Take>
bool receive(network::UdpReceiver& at, Take&& take) {
  for (const MonotonicTime end = monotonic_now() + seconds(30); monotonic_now() < end;) {
    for (const auto& d : at.receive(read_epoch()))
      if (take(d.bytes)) return true;
    std::this_thread::sleep_for(std::chrono::milliseconds(1));  // the pace of polling
  }
  return false;
}

/// Of the first column of the first packet at a port.
std::optional<std::uint64_t> first_column_ns(network::UdpReceiver& at, const PacketLayout& layout) {
  std::optional<std::uint64_t> ns;
  (void)receive(at, [&](Bytes b) {
    PacketFault fault{};
    if (const auto p = LidarPacket::parse(b, layout, fault)) ns = p->column(0).timestamp_ns();
    return ns.has_value();
  });
  return ns;
}

Result<Metadata> metadata_of(const Device& device) {
  return fetch_metadata({"127.0.0.1", device.http, 0, -1}, monotonic_now() + seconds(10));
}

TEST(OusterEmulatorRules, ReadingsComeAtTheirRateInTheTimeOfTheColumns) {
  Device device;
  network::UdpReceiver imu, lidar;
  ASSERT_TRUE(imu.open("127.0.0.1", device.port[1], 1 << 18));
  ASSERT_TRUE(lidar.open("127.0.0.1", device.port[0], 1 << 20, 65'507));
  ASSERT_TRUE(device.start(", timestamp_mode: TIME_FROM_PTP_1588", ", imu_rate_hz: 50"));
  std::vector<ImuPacket> readings;
  ASSERT_TRUE(receive(imu, [&](Bytes b) {
    const auto p = parse_imu(b);
    EXPECT_TRUE(p);
    if (p) readings.push_back(*p);
    return readings.size() == 6;
  }));
  for (std::size_t i = 1; i < readings.size(); ++i) {
    const std::uint64_t step = readings[i].accelerometer_ns - readings[i - 1].accelerometer_ns;
    EXPECT_EQ(step % 20'000'000, 0U) << "on the grid of its rate";
    EXPECT_GT(step, 0U);
  }
  EXPECT_EQ(readings[0].acceleration_g, (std::array<float, 3>{0, 0, 1}));
  const auto m = metadata_of(device);
  ASSERT_TRUE(m);
  const auto column_ns = first_column_ns(lidar, layout_of(*m));
  ASSERT_TRUE(column_ns);
  const auto apart = static_cast<std::int64_t>(*column_ns - readings[0].accelerometer_ns);
  EXPECT_LT(std::abs(apart), 20'000'000'000) << "one clock for both";
}

TEST(OusterEmulatorRules, SendsNoPacketWithoutAColumnOfItsWindow) {
  Device device;
  network::UdpReceiver lidar;
  ASSERT_TRUE(lidar.open("127.0.0.1", device.port[0], 1 << 20, 65'507));
  ASSERT_TRUE(device.start(", azimuth_window: [270000, 90000]"));
  const auto m = metadata_of(device);
  ASSERT_TRUE(m);
  const PacketLayout layout = layout_of(*m);
  std::size_t packets = 0;
  ASSERT_TRUE(receive(lidar, [&](Bytes b) {
    PacketFault fault{};
    const auto p = LidarPacket::parse(b, layout, fault);
    EXPECT_TRUE(p) << text_of(fault);
    std::uint32_t good = 0;
    for (std::uint32_t i = 0; p && i < p->columns(); ++i) good += p->column(i).good();
    EXPECT_GT(good, 0U);
    return ++packets == 40;
  }));
}

TEST(OusterEmulatorRules, SendsToTheDestinationThatItIsGivenLast) {
  Device device;
  network::UdpReceiver first, second;
  ASSERT_TRUE(first.open("127.0.0.1", device.port[0], 1 << 20, 65'507));
  ASSERT_TRUE(second.open("127.0.0.2", device.port[0], 1 << 20, 65'507));
  ASSERT_TRUE(device.start());
  const auto any = [](Bytes) { return true; };
  ASSERT_TRUE(receive(first, any));
  EXPECT_EQ(device.ask("POST", "/api/v1/sensor/config", R"({"udp_dest": "127.0.0.2"})").status, 200);
  EXPECT_TRUE(receive(second, any));
}

TEST(OusterEmulatorRules, ItsOwnClockCountsSinceItWasSwitchedOn) {
  Device device;
  network::UdpReceiver lidar;
  ASSERT_TRUE(lidar.open("127.0.0.1", device.port[0], 1 << 20, 65'507));
  ASSERT_TRUE(device.start("", ", start_up_ms: 300"));
  const auto m = metadata_of(device);
  ASSERT_TRUE(m);
  const auto first_ns = first_column_ns(lidar, layout_of(*m));
  ASSERT_TRUE(first_ns);
  EXPECT_GE(*first_ns, 290'000'000U) << "the start-up is a part of it";
}

/// Measures a frame of 100 ms in 250 ms: the machine that is too slow, which the test is about.
class SlowLidar final : public SampleProvider {
 public:
  Geometry geometry() const override { return lidar_.geometry(); }
  const models::LidarScan* scan() const override { return lidar_.scan(); }
  Status capture(const Request& r, Sample& sample) override {
    std::this_thread::sleep_for(std::chrono::milliseconds(250));
    return lidar_.capture(r, sample);
  }

 private:
  test::FormulaLidar lidar_;
};

TEST(OusterEmulatorRules, OnASlowMachineSendsTheFramesThatItCanMeasureAndCountsTheOthers) {
  OusterEmulator emulator;
  DeviceParts parts;
  parts.samples = std::make_shared<SlowLidar>();
  emulator.attach(std::move(parts));
  const auto port = network::test::free_ports();
  ASSERT_TRUE(emulator.configure(config_of("{tcp_port: 0, http_port: 0, config: {udp_port_lidar: " +
                                           std::to_string(port[0]) + ", udp_port_imu: 0}}")));
  ASSERT_TRUE(emulator.arm({}));
  ASSERT_TRUE(emulator.start(bench_now()));
  EXPECT_TRUE(rigor::test::eventually([&] {
    return emulator.health().received >= 2 * 32 && emulator.health().lost >= 32;
  })) << emulator.health().received
      << " sent, " << emulator.health().lost << " left out";
  EXPECT_EQ(emulator.health().retries, 0U) << "nothing is sent to the port 0 of the readings";
  ASSERT_TRUE(emulator.stop());
}

TEST(OusterEmulatorRules, SendsNothingInStandby) {
  Device device;
  ASSERT_TRUE(device.start(", operating_mode: STANDBY"));
  std::this_thread::sleep_for(
      std::chrono::milliseconds(200));  // two frames, which no event says were left out
  EXPECT_EQ(device.emulator->health().received, 0U);
  EXPECT_EQ(device.ask("POST", "/api/v1/sensor/config", R"({"operating_mode": "NORMAL"})").status, 200);
  EXPECT_TRUE(rigor::test::eventually([&] { return device.emulator->health().received > 0; }));
}

TEST(OusterEmulatorRules, SendsNoReadingsOfTheTimeBeforeItsStart) {
  Device device;
  network::UdpReceiver imu;
  ASSERT_TRUE(imu.open("127.0.0.1", device.port[1], 1 << 18));
  ASSERT_TRUE(device.start("", ", start_up_ms: 300"));
  std::optional<ImuPacket> first;
  ASSERT_TRUE(receive(imu, [&](Bytes b) { return (first = parse_imu(b)).has_value(); }));
  EXPECT_GE(first->accelerometer_ns, 290'000'000U);
}

TEST(OusterEmulatorRules, IsConnectedWhileSomebodyTakesItsPackets) {
  Device device;
  ASSERT_TRUE(device.start(", udp_port_imu: 0"));
  EXPECT_TRUE(rigor::test::eventually([&] { return !device.emulator->health().connected; }));
  network::UdpReceiver lidar;
  ASSERT_TRUE(lidar.open("127.0.0.1", device.port[0], 1 << 20, 65'507));
  EXPECT_TRUE(rigor::test::eventually([&] { return device.emulator->health().connected; }));
}

TEST(OusterEmulatorRules, GivesUpWhatItCouldNotSendInTime) {
  // A recording that nobody reads holds up the thread that sends; two frames are measured ahead.
  rigor::test::TemporaryDirectory dir;
  const std::string pipe = dir.file("sent.pcap");
  ASSERT_EQ(mkfifo(pipe.c_str(), 0600), 0);
  const FileDescriptor reader(open(pipe.c_str(), O_RDONLY | O_NONBLOCK | O_CLOEXEC));
  ASSERT_TRUE(reader);
  Device device;
  network::UdpReceiver lidar;
  ASSERT_TRUE(lidar.open("127.0.0.1", device.port[0], 4 << 20, 65'507));
  ASSERT_TRUE(device.start(", timestamp_mode: TIME_FROM_PTP_1588", ", imu_rate_hz: 0, pcap: " + pipe));
  const auto m = metadata_of(device);
  ASSERT_TRUE(m);
  ASSERT_TRUE(rigor::test::eventually([&] { return device.emulator->health().received > 0; }));
  std::this_thread::sleep_for(
      std::chrono::milliseconds(400));  // four frames: two wait, those behind are late
  std::atomic<bool> stopped{false};
  std::thread drain([&] {
    for (std::vector<char> some(1 << 16); !stopped;)
      if (read(reader.get(), some.data(), some.size()) <= 0)
        std::this_thread::sleep_for(std::chrono::milliseconds(1));  // the pace of polling
  });
  const std::uint64_t before = device.emulator->health().received;
  EXPECT_TRUE(rigor::test::eventually([&] {
    return device.emulator->health().lost > 0 && device.emulator->health().received > before + 64;
  }));
  EXPECT_TRUE(device.emulator->stop());
  stopped = true;
  drain.join();
  const EpochPair epoch = read_epoch();
  const PacketLayout layout = layout_of(*m);
  Duration latest;
  for (bool more = true; more;) {
    const auto batch = lidar.receive(epoch);
    more = !batch.empty();
    for (const auto& d : batch) {
      PacketFault fault{};
      const auto p = LidarPacket::parse(d.bytes, layout, fault);
      ASSERT_TRUE(p) << text_of(fault);
      const std::uint64_t last_ns = p->column(p->columns() - 1).timestamp_ns();
      const auto arrival_ns = static_cast<std::uint64_t>((epoch.to_utc(d.arrival) + seconds(37)).ns());
      latest = std::max(latest, Duration(static_cast<std::int64_t>(arrival_ns - last_ns)));
    }
  }
  EXPECT_GT(latest, Duration(0));
  EXPECT_LT(latest, milliseconds(200)) << "100 ms, and what a busy machine adds";
}

TEST(OusterEmulatorRules, WhatItSentIsInItsRecordingWhenItHasStopped) {
  rigor::test::TemporaryDirectory dir;
  Device device;
  ASSERT_TRUE(device.start("", ", pcap: " + dir.file("sent.pcap")));
  std::ofstream(dir.file("sent.json")) << device.ask("GET", "/api/v1/sensor/metadata").body;
  ASSERT_TRUE(rigor::test::eventually([&] { return device.emulator->health().received >= 40; }));
  ASSERT_TRUE(device.emulator->stop());
  const auto report = inspect_pcap(dir.file("sent.pcap"), dir.file("sent.json"));
  ASSERT_TRUE(report) << report.error().text();
  EXPECT_FALSE(report->ended_by);
  EXPECT_EQ(report->lidar_packets, device.emulator->health().received);
  EXPECT_EQ(report->malformed, 0U);
}

/// A recording in virtual time.
struct Recording {
  rigor::test::TemporaryDirectory dir;
  std::string pcap = dir.file("a.pcap"), json = dir.file("a.json");

  explicit Recording(const test::Recorded& what) { EXPECT_TRUE(test::record_sensor(pcap, json, what)); }
  std::vector<SampleLease> play(OusterSource& source, const std::string& more = "") const {
    return run_virtual(source, config_of("{file: " + pcap + ", metadata: " + json + more + "}"),
                       milliseconds(900));
  }
};

TEST(OusterSourceRules, ALastFrameThatIsNotWholeIsHandedOnWithTheEndOfTheRecording) {
  const Recording r(
      {.frames = 3, .lost = [](std::uint64_t f, std::uint32_t slot) { return f == 2 && slot > 20; }});
  OusterSource source;
  const auto got = r.play(source);
  ASSERT_EQ(got.size(), 3U);
  EXPECT_EQ(got[2]->stamp.validity & kIncomplete, kIncomplete);
  EXPECT_EQ(source.counters().packets_lost, 11U);
}

TEST(OusterSourceRules, CountsAnewWithEachRun) {
  const Recording r({.frames = 2});
  OusterSource source;
  (void)r.play(source);
  EXPECT_EQ(source.counters().packets, 64U);
  ASSERT_TRUE(source.stop());
  ASSERT_TRUE(source.arm({}));
  EXPECT_EQ(source.counters().packets, 0U);
  ASSERT_TRUE(source.stop());
}

TEST(OusterSourceRules, ARecordingThatBreaksOffIsAProtocolError) {
  const Recording r({.frames = 2});
  OusterSource whole;
  (void)r.play(whole);
  EXPECT_EQ(whole.health().protocol_errors, 0U);
  std::filesystem::resize_file(r.pcap, std::filesystem::file_size(r.pcap) - 100);
  OusterSource broken;
  (void)r.play(broken);
  EXPECT_EQ(broken.health().protocol_errors, 1U);
  EXPECT_FALSE(broken.health().connected);
}

TEST(OusterSourceRules, ARecordingMayHavePacketsOfOtherPorts) {
  const Recording r({.frames = 1});
  OusterSource source;
  ASSERT_TRUE(
      source.configure(config_of("{file: " + r.pcap + ", metadata: " + r.json + ", lidar_port: 7000}")));
  const auto s = source.arm({});
  ASSERT_FALSE(s);
  EXPECT_EQ(s.error().code, ErrorCode::bad_input);
  OusterSource own;
  EXPECT_EQ(r.play(own, ", lidar_port: " + std::to_string(kLidarPort)).size(), 1U);
}

TEST(OusterSourceRules, UtcOfARecordingIsThatOfItsStamps) {
  // Its stamps are of when packets were full; the sensor counted UTC.
  const Recording r({.frames = 2, .start_ns = 1'700'000'000'000'000'000});
  std::ifstream in(r.json);
  std::string text{std::istreambuf_iterator<char>(in), {}};
  const std::string internal = "TIME_FROM_INTERNAL_OSC";
  for (const bool ptp : {false, true}) {
    if (ptp) text.replace(text.find(internal), internal.size(), "TIME_FROM_PTP_1588");
    std::ofstream(r.json) << text;
    OusterSource source;
    const auto got = r.play(source, ", time: utc");
    ASSERT_EQ(got.size(), 2U);
    EXPECT_EQ(got[0]->stamp.t_capture.ns(), -3'125'000) << "a packet of 16 of 512 columns before its stamp";
    EXPECT_EQ(got[1]->stamp.t_capture.ns(), 96'875'000);
  }
}

TEST(OusterSourceRules, ReadingsAreMissedByThePeriodOfTheChannel) {
  const Recording r({.frames = 1});
  auto writer = network::PcapWriter::create(r.pcap);
  ASSERT_TRUE(writer);
  for (std::int64_t i = 0; i < 8; ++i) {
    if (i == 5) continue;
    ImuPacket p;
    p.system_ns = p.accelerometer_ns = p.gyroscope_ns = static_cast<std::uint64_t>(1 + i) * 20'000'000;
    p.acceleration_g = {0, 0, 1};
    writer->write(RealtimeTime(1'700'000'000'000'000'000 + i * 20'000'000),
                  {0x7F000001, 0x7F000001, kImuPort, kImuPort, compose_imu(p)});
  }
  ASSERT_TRUE(writer->flush());
  OusterSource source;
  auto config = config_of("{file: " + r.pcap + ", metadata: " + r.json + "}", SampleKind::imu);
  config.period = milliseconds(20);
  EXPECT_EQ(run_virtual(source, config, milliseconds(300)).size(), 7U);
  EXPECT_EQ(source.counters().packets, 7U);
  EXPECT_EQ(source.counters().packets_lost, 1U);
}

/// A sensor that sends a packet every few milliseconds and is as far in its start-up as the test says.
class SteppedSensor {
  std::uint16_t port_ = network::test::free_ports()[0], http_ = 0;
  SensorDevice device_ = SensorDevice::create(std::make_shared<test::FormulaLidar>()).value();
  SensorControl control_;
  const Metadata metadata_;

 public:
  explicit SteppedSensor(const std::string& window_mdeg = "[0, 360000]")
      : control_(SensorControl::create(device_, {.start_up = seconds(1)},
                                       "{\"udp_port_lidar\": " + std::to_string(port_) +
                                           ", \"azimuth_window\": " + window_mdeg + "}",
                                       MonotonicTime(0))
                     .value()),
        metadata_(control_.active().metadata),
        initialization_id(metadata_.initialization_id) {
    EXPECT_TRUE(sender_.open("127.0.0.1", port_));
    const auto http =
        server_.listen("127.0.0.1", 0, {},
                       network::http_server([this](const network::HttpRequest& r, std::string_view client) {
                         const auto reply = control_.http(r.method, r.target, r.body, client,
                                                          MonotonicTime(seconds(now_s).ns()));
                         metadata_asked_for += r.target == "/api/v1/sensor/metadata";
                         return network::HttpReply{reply.status, reply.body};
                       }));
    EXPECT_TRUE(http);
    http_ = http.value_or(0);
    EXPECT_TRUE(server_.start());
    thread_ = std::thread([this] { send(); });
  }
  ~SteppedSensor() {
    stop_ = true;
    thread_.join();
    server_.stop();
  }
  /// Of the packets from now on.
  std::atomic<std::uint32_t> initialization_id;
  std::atomic<std::int64_t> now_s = 2;
  std::atomic<int> metadata_asked_for = 0;

  [[nodiscard]] std::string host() const { return "host: 127.0.0.1, http_port: " + std::to_string(http_); }
  /// With another configuration, as JSON. Takes a second, until when it is INITIALIZING.
  void reinitialize(const std::string& config = "{}") {
    const auto r = network::http_request("127.0.0.1", http_, {"POST", "/api/v1/sensor/config", config},
                                         monotonic_now() + seconds(10), -1);
    ASSERT_TRUE(r);
    ASSERT_EQ(r->status, 200) << r->body;
    ++initialization_id;
  }

 private:
  void send() {
    const Metadata& m = metadata_;
    LidarPacketWriter packet(layout_of(m));
    for (std::uint32_t n = 0; !stop_; ++n) {
      packet.set_header(static_cast<std::uint16_t>(n / m.slots()), initialization_id, 1);
      for (std::uint32_t i = 0; i < m.columns_per_packet; ++i)
        packet.set_column(i, 1 + n, static_cast<std::uint16_t>(n % m.slots() * m.columns_per_packet + i),
                          true);
      (void)sender_.send(packet.bytes(), port_, realtime_now());
      std::this_thread::sleep_for(std::chrono::milliseconds(2));  // the pace of its packets
    }
  }

  network::UdpSender sender_;
  network::TcpServer server_;
  std::atomic<bool> stop_{false};
  std::thread thread_;
};

testing::AssertionResult starts(OusterSource& source, const std::string& keys) {
  auto s = source.configure(config_of("{" + keys + "}"));
  if (s) s = source.arm({});
  if (s) s = source.start(bench_now());
  return s ? testing::AssertionSuccess() : testing::AssertionFailure() << s.error().text();
}

TEST(OusterSourceRules, FollowsASensorThatStartsAnewOnceItIsRunning) {
  SteppedSensor sensor;
  OusterSource source;
  ASSERT_TRUE(starts(source, "buffers: 32, " + sensor.host()));
  sensor.reinitialize();
  const int before = sensor.metadata_asked_for;
  EXPECT_TRUE(rigor::test::eventually([&] { return sensor.metadata_asked_for >= before + 2; }))
      << "asks again while it is INITIALIZING";
  EXPECT_EQ(source.counters().reinitialized, 0U);
  sensor.now_s = 4;
  EXPECT_TRUE(rigor::test::eventually([&] { return source.counters().reinitialized == 1; }));
  ASSERT_TRUE(source.stop());
}

TEST(OusterSourceRules, ASensorWhoseFramesNoLongerFitIsAProtocolError) {
  SteppedSensor sensor("[270000, 90000]");
  OusterSource source;
  ASSERT_TRUE(starts(source, "buffers: 32, " + sensor.host()));
  EXPECT_EQ(source.health().protocol_errors, 0U);
  sensor.reinitialize(R"({"azimuth_window": [0, 360000]})");
  sensor.now_s = 4;
  EXPECT_TRUE(rigor::test::eventually([&] { return source.health().protocol_errors > 0; }));
  EXPECT_EQ(source.counters().reinitialized, 0U);
  ASSERT_TRUE(source.stop());
}

TEST(OusterSourceRules, IsNotSetUpAnewForPacketsThatTheMetadataAreNotOf) {
  SteppedSensor sensor;
  OusterSource source;
  ASSERT_TRUE(starts(source, "buffers: 32, " + sensor.host()));
  const int before = sensor.metadata_asked_for;
  ++sensor.initialization_id;
  EXPECT_TRUE(rigor::test::eventually([&] { return sensor.metadata_asked_for >= before + 2; }));
  EXPECT_EQ(source.counters().reinitialized, 0U);
  EXPECT_EQ(source.health().protocol_errors, 0U);
  ASSERT_TRUE(source.stop());
}

TEST(OusterSourceRules, SaysWhereTheKernelGrantsLessBufferThanWasAskedFor) {
  Device device;
  ASSERT_TRUE(device.start());
  // 1 GiB is one byte more than Linux grants to anybody.
  for (const auto& [bytes, warnings] : {std::pair{1 << 16, 0U}, std::pair{1 << 30, 1U}}) {
    OusterSource source;
    ASSERT_TRUE(source.configure(
        config_of("{socket_buffer_bytes: " + std::to_string(bytes) + ", " + device.host() + "}")));
    const auto s = source.arm({});
    ASSERT_TRUE(s) << s.error().text();
    ASSERT_EQ(source.warnings().size(), warnings);
    if (warnings > 0) {
      EXPECT_NE(source.warnings()[0].find("1048576 KiB asked for"), std::string::npos);
    }
    ASSERT_TRUE(source.stop());
  }
}

TEST(OusterSourceRules, ALiveSensorOnPtpCountsTai) {
  Device device;
  ASSERT_TRUE(device.start(", timestamp_mode: TIME_FROM_PTP_1588"));
  OusterSource source;
  ASSERT_TRUE(starts(source, "buffers: 32, time: utc, " + device.host()));
  std::vector<SampleLease> got;
  ASSERT_TRUE(poll_until(source, got, [&] { return !got.empty(); }));
  EXPECT_GT(got[0]->stamp.t_capture, bench_now() - seconds(30))
      << "37 s of leap seconds were taken off twice";
  ASSERT_TRUE(source.stop());
  EXPECT_FALSE(source.health().connected);
}

TEST(OusterSourceRules, SaysWhenPacketsAreOfAnotherSensor) {
  const Recording single({.frames = 1});
  Device device;
  ASSERT_TRUE(device.start(", udp_profile_lidar: RNG15_RFL8_NIR8"));
  OusterSource source;
  ASSERT_TRUE(source.configure(
      config_of("{metadata: " + single.json + ", lidar_port: " + std::to_string(device.port[0]) + "}")));
  const auto s = source.arm({});
  ASSERT_FALSE(s);
  EXPECT_NE(s.error().text().find("of something else"), std::string::npos) << s.error().text();
}

TEST(OusterSourceRules, DoesNotWaitForASensorInStandbyToRun) {
  Device device;
  ASSERT_TRUE(device.start(", operating_mode: STANDBY"));
  OusterSource source;
  ASSERT_TRUE(source.configure(config_of("{ready_s: 1, " + device.host() + "}")));
  const auto s = source.arm({});
  ASSERT_FALSE(s);
  EXPECT_NE(s.error().text().find("got one in STANDBY"), std::string::npos) << s.error().text();
}

TEST(OusterSourceRules, EscapesTheParametersThatItSends) {
  std::vector<std::string> asked;
  network::TcpServer server;
  const auto port = server.listen("127.0.0.1", 0, {},
                                  network::http_server([&](const network::HttpRequest& r, std::string_view) {
                                    asked.push_back(r.target);
                                    return network::HttpReply{200, "{}"};
                                  }));
  ASSERT_TRUE(port);
  ASSERT_TRUE(server.start());
  const auto anew = configure_sensor({"127.0.0.1", *port, 0, -1}, R"({"udp_dest": "10.0.0.1"})",
                                     monotonic_now() + seconds(10));
  server.stop();
  ASSERT_TRUE(anew) << anew.error().text();
  EXPECT_TRUE(*anew);
  const std::string cmd = "/api/v1/sensor/cmd/";
  EXPECT_EQ(asked, (std::vector{cmd + "get_config_param?args=active",
                                cmd + "set_config_param?args=.+%7B%22udp_dest%22%3A%2210.0.0.1%22%7D",
                                cmd + "reinitialize"}));
}

TEST(OusterSourceRules, SaysWhichStatusOfHttpCameInPlaceOfMetadata) {
  network::TcpServer server;
  const auto port = server.listen("127.0.0.1", 0, {},
                                  network::http_server([](const network::HttpRequest&, std::string_view) {
                                    return network::HttpReply{503, "{}"};
                                  }));
  ASSERT_TRUE(port);
  ASSERT_TRUE(server.start());
  const auto m = fetch_metadata({"127.0.0.1", *port, 0, -1}, monotonic_now() + seconds(10));
  ASSERT_FALSE(m);
  EXPECT_EQ(m.error().code, ErrorCode::unavailable);
  EXPECT_NE(m.error().text().find("503"), std::string::npos) << m.error().text();
  server.stop();
}

}  // namespace
}  // namespace rigor::ouster
