// The emulated device and its readers: in virtual time, from a recording, over loopback with its commands,
// told anew while it runs, and gone for a while.
#include <gtest/gtest.h>

#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <thread>

#include "drivers/livox/livox_emulator.h"
#include "drivers/livox/livox_source.h"
#include "drivers/livox/livox_virtual_source.h"
#include "drivers/livox/pcap_report.h"
#include "drivers/network/pcap_file.h"
#include "rt-core/byte_order.h"
#include "tests/drivers/livox/made_livox.h"
#include "tests/drivers/network/free_ports.h"
#include "tests/paths.h"

namespace rigor::livox {
namespace {

using packet_lidar::test::points_of;
using packet_lidar::test::poll_until;
using packet_lidar::test::run_virtual;
using test::FormulaMid360;

ChannelConfig config_of(const std::string& params, SampleKind kind = SampleKind::point_cloud) {
  const bool imu = kind == SampleKind::imu;
  return packet_lidar::test::channel_config(params, kind, milliseconds(imu ? 5 : 20),
                                            milliseconds(imu ? 5 : 30));
}
DeviceParts made_parts() {
  DeviceParts parts;
  parts.samples = std::make_shared<FormulaMid360>();
  return parts;
}
TEST(LivoxVirtual, GivesWhatTheSimulatorMeasuredInFramesOfTheChannelsPeriod) {
  VirtualSource source(made_parts(), config_of("{}").params);
  const auto got = run_virtual(source, config_of("{buffers: 16}"), milliseconds(255));
  ASSERT_EQ(got.size(), 12u);
  for (std::size_t i = 0; i < got.size(); ++i) {
    EXPECT_EQ(got[i]->stamp.sequence, i);
    EXPECT_EQ(got[i]->stamp.validity, 0u);
    EXPECT_EQ(got[i]->stamp.t_capture.ns(), static_cast<std::int64_t>(i) * 20'000'000);
    const auto points = points_of(got[i]);
    EXPECT_EQ(points.size(), 3875u);
    for (const LidarPoint& p : points) {
      const auto at = FormulaMid360::place_m(i * 4000 + static_cast<std::uint64_t>(p.t_offset_ns) / 5000);
      ASSERT_NEAR(p.x_m, at[0], 5.1e-4);
      ASSERT_NEAR(p.z_m, at[2], 5.1e-4);
    }
  }
}

TEST(LivoxVirtual, HasItsInertialUnit) {
  VirtualSource source(made_parts(), config_of("{}").params);
  const auto got = run_virtual(source, config_of("{buffers: 64}", SampleKind::imu), milliseconds(100));
  ASSERT_EQ(got.size(), 20u);
  for (std::size_t i = 0; i < got.size(); ++i) {
    EXPECT_EQ(got[i]->stamp.sequence, i);
    EXPECT_EQ(got[i]->stamp.t_capture.ns(), static_cast<std::int64_t>(i) * 5'000'000);
    EXPECT_NEAR(got[i]->as<ImuSample>()->specific_force_mps2[2], 9.80665, 1e-6);
  }
}

TEST(LivoxVirtual, RefusesWhatCannotBe) {
  ArmContext context;
  context.virtual_time = true;
  VirtualSource early(made_parts(), config_of("{}").params);
  auto config = config_of("{}");
  config.latency = milliseconds(20);
  ASSERT_TRUE(early.configure(config));
  const auto s = early.arm(context);
  ASSERT_FALSE(s);
  EXPECT_NE(s.error().text().find("latency_ms"), std::string::npos) << s.error().text();
  VirtualSource idle(made_parts(), config_of("{mode: idle}").params);
  ASSERT_TRUE(idle.configure(config_of("{}")));
  EXPECT_NE(idle.arm(context).error().text().find("IDLE"), std::string::npos);
  VirtualSource told(made_parts(), config_of("{mode: idle}").params);
  ASSERT_TRUE(told.configure(config_of("{host: 127.0.0.1}")));
  EXPECT_TRUE(told.arm(context));
}

/// Half a second with a packet missing and one damaged, commands and something else in between.
void record(const std::string& file) {
  auto device = Mid360Device::create(std::make_shared<FormulaMid360>());
  ASSERT_TRUE(device);
  auto writer = network::PcapWriter::create(file);
  ASSERT_TRUE(writer);
  std::vector<packet_lidar::Scan> scans(7, device->make_scan());
  for (std::uint64_t k = 0; k < scans.size(); ++k)
    ASSERT_TRUE(device->measure(k, BenchTime(0), {}, scans[k]));
  std::vector<std::uint8_t> bytes;
  for (std::uint64_t j = 0; j < 1100; ++j) {
    const RealtimeTime t(1'700'000'000'000'000'000 + Mid360Device::filled(j).ns());
    if (j % 10 == 0) {
      PacketHead head;
      head.timestamp_ns = j / 10 * 5'000'000;
      const auto imu = compose_imu(head, at_rest());
      writer->write(t, {0x7F000001, 0x7F000001, kImuPort, kHostImuPort, imu});
    }
    if (j == 5) writer->write(t, {1, 2, 9, 9, Bytes(bytes).first(20)});
    if (j == 6) {
      const auto command = compose_command({1, CommandId::search, false, false, {}});
      writer->write(t, {1, 2, 40000, kSearchPort, command});
    }
    if (j == 300) continue;
    device->compose(
        j, DataType::cartesian_mm, {}, [&](std::uint64_t k) { return &scans.at(k); }, bytes);
    if (j == 500) bytes[60] ^= 1;
    writer->write(t, {0x7F000001, 0x7F000001, kPointPort, kHostPointPort, bytes});
  }
}

TEST(LivoxRecording, IsReadInVirtualTime) {
  rigor::test::TemporaryDirectory dir;
  record(dir.file("a.pcap"));
  LivoxSource source;
  const auto got =
      run_virtual(source, config_of("{buffers: 64, file: " + dir.file("a.pcap") + "}"), milliseconds(700));
  ASSERT_EQ(got.size(), 26u);
  EXPECT_EQ(points_of(got[0]).size(), 3875u);
  EXPECT_EQ(source.counters().packets_lost, 2u) << "one missing, one damaged";
  EXPECT_EQ(got[7]->stamp.validity & kIncomplete, kIncomplete);
  EXPECT_EQ(got[8]->stamp.validity, 0u);
  EXPECT_FALSE(source.health().connected) << "it has ended";
  LivoxSource imu;
  const auto readings = run_virtual(
      imu, config_of("{buffers: 256, file: " + dir.file("a.pcap") + "}", SampleKind::imu), milliseconds(700));
  EXPECT_EQ(readings.size(), 110u);
  LivoxSource elsewhere;
  ASSERT_TRUE(elsewhere.configure(config_of("{port: 56302, file: " + dir.file("a.pcap") + "}")));
  EXPECT_FALSE(elsewhere.arm({}));
}

TEST(LivoxRecording, IsInspected) {
  rigor::test::TemporaryDirectory dir;
  record(dir.file("a.pcap"));
  EXPECT_TRUE(is_livox_recording(dir.file("a.pcap")));
  std::ofstream(dir.file("b.pcap")) << "nothing";
  EXPECT_FALSE(is_livox_recording(dir.file("b.pcap")));
  const auto r = inspect_pcap(dir.file("a.pcap"));
  ASSERT_TRUE(r) << r.error().text();
  EXPECT_EQ(r->point_packets, 1098u);
  EXPECT_EQ(r->imu_packets, 110u);
  EXPECT_EQ(r->malformed, 1u);
  EXPECT_EQ(r->faults.at("wrong checksum"), 1u);
  EXPECT_EQ(r->commands, 1u);
  EXPECT_EQ(r->other_datagrams, 1u);
  EXPECT_EQ(r->stream.packets_lost, 2u);
  EXPECT_EQ(r->stream.frames, 5u);
  EXPECT_EQ(r->stream.frames_incomplete, 2u);
  EXPECT_EQ(r->without_return, 1098u * 3);
  EXPECT_EQ(r->returns_per_line[3], 1098u * 21) << "the line that has the firings without one";
  EXPECT_EQ(r->returns_per_line[0], 1098u * 24);
  EXPECT_NEAR(r->packets_per_s, 1097 / (1099 * 480e-6), 0.01);
  EXPECT_NEAR(r->minimum_range_m, 4, 0.01);
  EXPECT_NEAR(r->maximum_range_m, 13.96, 0.01);
  EXPECT_FALSE(r->ended_by);
}

/// An emulator that serves now, at ports of its own.
struct Device {
  std::array<std::uint16_t, 2> port = network::test::free_ports();
  std::unique_ptr<LivoxEmulator> emulator = std::make_unique<LivoxEmulator>();
  std::uint16_t command = 0;  ///< 0: any

  Status start(const std::string& more = "") {
    emulator->attach(made_parts());
    const std::string keys =
        "{lidar_ports: false, search_port: 0, state_port: 0, command_port: " + std::to_string(command) +
        more + "}";
    if (auto s = emulator->configure(config_of(keys)); !s) return s;
    if (auto s = emulator->arm({}); !s) return s;
    command = emulator->command_port();
    return emulator->start(bench_now());
  }
  [[nodiscard]] std::string keys(std::size_t which) const {
    return "host: 127.0.0.1, command_port: " + std::to_string(command) +
           ", port: " + std::to_string(port[which]);
  }
};

TEST(LivoxEmulator, IsToldToMeasureAndSendsPointsAndReadings) {
  Device device;
  auto s = device.start(", start_up_ms: 150, mode: idle, imu: false, point_port: 0, imu_port: 0");
  ASSERT_TRUE(s) << s.error().text();
  LivoxSource points, imu;
  ASSERT_TRUE(points.configure(config_of("{buffers: 64, data_type: spherical, " + device.keys(0) + "}")));
  ASSERT_TRUE(imu.configure(config_of("{buffers: 256, " + device.keys(1) + "}", SampleKind::imu)));
  s = points.arm({});  // waits until it is SAMPLING
  ASSERT_TRUE(s) << s.error().text();
  s = imu.arm({});
  ASSERT_TRUE(s) << s.error().text();
  const BenchTime t0 = bench_now();
  ASSERT_TRUE(points.start(t0));
  ASSERT_TRUE(imu.start(t0));
  std::vector<SampleLease> clouds, readings;
  ASSERT_TRUE(poll_until(points, clouds, [&] { return clouds.size() >= 5; }));
  ASSERT_TRUE(poll_until(imu, readings, [&] { return readings.size() >= 20; }));
  for (std::size_t i = 0; i < clouds.size(); ++i) {
    if ((clouds[i]->stamp.validity & kIncomplete) == 0) {
      EXPECT_NEAR(static_cast<double>(points_of(clouds[i]).size()), 3875, 5);
    }
    if (i > 0) {
      EXPECT_EQ(clouds[i]->stamp.sequence, clouds[i - 1]->stamp.sequence + 1 + clouds[i]->stamp.lost_before);
      EXPECT_GT(clouds[i]->stamp.t_capture, clouds[i - 1]->stamp.t_capture);
    }
    EXPECT_LE(clouds[i]->stamp.t_capture.ns(), monotonic_now().ns());
  }
  EXPECT_NEAR(readings[0]->as<ImuSample>()->specific_force_mps2[2], 9.80665, 1e-6);
  EXPECT_EQ(points.counters().foreign, 0u);
  ASSERT_TRUE(points.stop());
  ASSERT_TRUE(imu.stop());
  ASSERT_TRUE(device.emulator->stop());
}

TEST(LivoxEmulator, IsFoundByItsSearchAndAnswersInquiries) {
  LivoxEmulator emulator;
  emulator.attach(made_parts());
  const auto search = network::test::free_ports()[0];
  ASSERT_TRUE(emulator.configure(
      config_of("{lidar_ports: false, command_port: 0, point_port: 0, imu_port: 0, state_port: 0, "
                "mode: ready, serial: ABC123, search_port: " +
                std::to_string(search) + "}")));
  ASSERT_TRUE(emulator.arm({}));
  ASSERT_TRUE(emulator.start(bench_now()));
  const auto found = search_lidars("127.0.0.1", search, milliseconds(200));
  ASSERT_EQ(found.size(), 1u);
  EXPECT_EQ(found[0].serial, "ABC123");
  EXPECT_EQ(found[0].address, "127.0.0.1");
  EXPECT_EQ(found[0].type, kMid360Type);
  EXPECT_EQ(found[0].command_port, emulator.command_port());
  CommandClient client;
  ASSERT_TRUE(client.open("127.0.0.1", found[0].command_port, "0.0.0.0"));
  EXPECT_EQ(client.local_ipv4(), 0x7F000001u);
  EXPECT_EQ(client.state(monotonic_now() + seconds(5)), WorkState::ready);
  const std::uint8_t nine = 9;
  const std::vector<Parameter> wrong{{Key::data_type, Bytes(&nine, 1)}};
  const auto refused = client.set(wrong, monotonic_now() + seconds(5));
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, ErrorCode::bad_input);
  EXPECT_NE(refused.error().text().find("refuses 0x0000: the value is out of range"), std::string::npos)
      << refused.error().text();
}

TEST(LivoxEmulator, IsADeviceToAHostThatKnowsTheDocumentAlone) {
  if (std::system("python3 -c pass > /dev/null 2>&1") != 0) GTEST_SKIP() << "python3 is not installed";
  LivoxEmulator emulator;
  emulator.attach(made_parts());
  const auto search = network::test::free_ports()[0];
  ASSERT_TRUE(
      emulator.configure(config_of("{lidar_ports: false, command_port: 0, point_port: 0, imu_port: 0, "
                                   "state_port: 0, mode: idle, search_port: " +
                                   std::to_string(search) + "}")));
  ASSERT_TRUE(emulator.arm({}));
  ASSERT_TRUE(emulator.start(bench_now()));
  const std::string line = "python3 " + rigor::test::source_dir() +
                           "/tests/drivers/livox/mid360_host.py 127.0.0.1 " +
                           std::to_string(emulator.command_port()) + " " + std::to_string(search) + " 300";
  std::string said;
  FILE* host = popen(line.c_str(), "r");
  ASSERT_NE(host, nullptr);
  char buffer[4096];
  while (const std::size_t n = std::fread(buffer, 1, sizeof buffer, host)) said.append(buffer, n);
  ASSERT_EQ(pclose(host), 0) << said;
  EXPECT_NE(said.find("\"serial\": \"47MDL00010101\""), std::string::npos) << said;
  EXPECT_NE(said.find("\"counts_go_with_stamps\": true"), std::string::npos) << said;
  EXPECT_EQ(said.find("false"), std::string::npos) << said;
  EXPECT_NE(said.find("\"shortest_step_ns\": 480000"), std::string::npos) << said;
  EXPECT_NE(said.find("\"returns\": 27900"), std::string::npos) << "of 28800 firings, " << said;
}

TEST(LivoxEmulator, PushesItsStateAndRebootsWhenAsked) {
  Device device;
  network::UdpReceiver host;
  ASSERT_TRUE(host.open("127.0.0.1", 0, 1 << 16));
  ASSERT_TRUE(device.start(", point_port: 0, imu_port: 0, start_up_ms: 60000"));
  CommandClient client;
  ASSERT_TRUE(client.open("127.0.0.1", device.command, "0.0.0.0"));
  const auto to = bytes_of({0x7F000001, host.port(), 0});
  const std::vector<Parameter> state{{Key::state_host, to}};
  ASSERT_TRUE(client.set(state, monotonic_now() + seconds(5)));
  std::optional<WorkState> pushed;
  for (const MonotonicTime end = monotonic_now() + seconds(10); !pushed && monotonic_now() < end;) {
    for (const auto& d : host.receive(read_epoch()))
      if (const auto c = parse_command(d.bytes); c && c->id == CommandId::push) {
        const auto parameters = parse_parameters(c->data.subspan(4), load_le<std::uint16_t>(c->data, 0));
        ASSERT_TRUE(parameters);
        for (const Parameter& p : *parameters)
          if (p.key == Key::state) pushed = static_cast<WorkState>(p.value[0]);
      }
    std::this_thread::sleep_for(std::chrono::milliseconds(5));  // the pace of polling, until the loop ends it
  }
  EXPECT_EQ(pushed, WorkState::self_check);
  const std::vector<std::uint8_t> now{0, 0};
  const auto reply = client.ask(CommandId::reboot, now, monotonic_now() + seconds(5));
  ASSERT_TRUE(reply);
  EXPECT_EQ((*reply)[0], 0);
}

TEST(LivoxSource, SurvivesADeviceThatGoesAndComesAndTellsItAgain) {
  Device device;
  // Switched on anew it does not know where to send to.
  ASSERT_TRUE(device.start(", point_port: 0, imu_port: 0"));
  LivoxSource source;
  ASSERT_TRUE(source.configure(config_of("{buffers: 128, " + device.keys(0) + "}")));
  const auto s = source.arm({});
  ASSERT_TRUE(s) << s.error().text();
  ASSERT_TRUE(source.start(bench_now()));
  std::vector<SampleLease> got;
  packet_lidar::test::expect_survival(
      source, got, [&] { return device.emulator->stop(); },
      [&] { return device.start(", point_port: 0, imu_port: 0"); });
  EXPECT_GE(source.counters().told_again, 1u);
  ASSERT_TRUE(source.stop());
}

TEST(LivoxSource, FollowsWhenAnotherHostChangesItsDataType) {
  Device device;
  ASSERT_TRUE(device.start(", imu_port: 0, point_port: " + std::to_string(device.port[0])));
  LivoxSource source;  // listens alone
  ASSERT_TRUE(source.configure(config_of("{buffers: 128, port: " + std::to_string(device.port[0]) + "}")));
  const auto s = source.arm({});
  ASSERT_TRUE(s) << s.error().text();
  ASSERT_TRUE(source.start(bench_now()));
  std::vector<SampleLease> got;
  ASSERT_TRUE(poll_until(source, got, [&] { return got.size() >= 2; }));
  CommandClient client;
  ASSERT_TRUE(client.open("127.0.0.1", device.command, "0.0.0.0"));
  const std::uint8_t two = 2;
  const std::vector<Parameter> type{{Key::data_type, Bytes(&two, 1)}};
  ASSERT_TRUE(client.set(type, monotonic_now() + seconds(5)));
  const auto in_centimetres = [&] {
    if (got.empty() || got.back()->size_bytes == 0) return false;
    for (const LidarPoint& p : points_of(got.back()))
      if (std::abs(static_cast<double>(p.x_m) * 100 - std::round(static_cast<double>(p.x_m) * 100)) > 1e-3)
        return false;
    return true;
  };
  EXPECT_TRUE(poll_until(source, got, in_centimetres));
  ASSERT_TRUE(source.stop());
}

TEST(LivoxSource, SaysWhenNobodyIsThereOrSomethingElse) {
  const auto port = network::test::free_ports();
  LivoxSource source;
  ASSERT_TRUE(source.configure(config_of("{host: 127.0.0.1, command_port: " + std::to_string(port[0]) +
                                         ", port: " + std::to_string(port[1]) + "}")));
  const auto s = source.arm({});
  ASSERT_FALSE(s);
  EXPECT_EQ(s.error().code, ErrorCode::not_found);
  EXPECT_NE(s.error().text().find("answers to commands"), std::string::npos) << s.error().text();
  EXPECT_EQ(source.state(), ChannelState::configured);
  EXPECT_FALSE(source.configure(config_of("{file: a.pcap, host: 127.0.0.1}")));
  EXPECT_FALSE(source.configure(config_of("{data_type: spherical}")));
  EXPECT_FALSE(source.configure(config_of("{host: lidar}")));
  Device device;
  ASSERT_TRUE(device.start(", start_up_ms: 60000"));
  ASSERT_TRUE(source.configure(config_of("{ready_s: 0.2, " + device.keys(0) + "}")));
  EXPECT_NE(source.arm({}).error().text().find("SELFCHECK"), std::string::npos);
}

}  // namespace
}  // namespace rigor::livox
