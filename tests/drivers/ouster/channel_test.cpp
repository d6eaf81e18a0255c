// The emulated sensor and its readers: in virtual time, from a recording, over loopback with its HTTP,
// configured anew while it runs, and gone for a while.
#include <gtest/gtest.h>

#include <fstream>
#include <iterator>
#include <thread>

#include "drivers/ouster/ouster_source.h"
#include "drivers/ouster/ouster_virtual_source.h"
#include "rt-core/byte_order.h"
#include "rt-core/file_descriptor.h"
#include "tests/drivers/network/free_ports.h"
#include "tests/drivers/ouster/ouster_device.h"
#include "tests/drivers/ouster/record_sensor.h"

namespace rigor::ouster {
namespace {

using packet_lidar::test::expect_numbered;
using packet_lidar::test::points_of;
using packet_lidar::test::poll_until;
using packet_lidar::test::run_virtual;
using test::config_of;
using test::Device;
using test::FormulaLidar;
using test::kBeams;
using test::parts_of;

class EveryProfile : public testing::TestWithParam<Profile> {};

TEST_P(EveryProfile, InVirtualTimeGivesWhatTheSimulatorMeasured) {
  const bool dual = GetParam() == Profile::dual;
  VirtualSource source(
      parts_of({512, 10}, dual),
      config_of("{config: {udp_profile_lidar: " + std::string(name_of(GetParam())) + "}}").params);
  const auto got = run_virtual(source, config_of("{buffers: 8}"), milliseconds(330));
  ASSERT_EQ(got.size(), 3u);
  const FormulaLidar lidar({512, 10}, dual);
  // The packet counts millimetres, the low-data profile eight of them.
  const double step_m = GetParam() == Profile::low_data ? 0.0045 : 0.0005;
  for (std::size_t i = 0; i < got.size(); ++i) {
    const Stamp& stamp = got[i]->stamp;
    EXPECT_EQ(stamp.sequence, i);
    EXPECT_EQ(stamp.validity, 0u);
    EXPECT_EQ(stamp.t_capture.ns(), static_cast<std::int64_t>(i) * 100'000'000);
    std::size_t second = 0;
    const auto points = points_of(got[i]);
    for (const LidarPoint& p : points) {
      const auto column =
          static_cast<std::uint32_t>(std::lround(static_cast<double>(p.t_offset_ns) * 512 / 1e8));
      const auto aim = models::rotor_aim(lidar.scan()->beams[p.ring], lidar.scan()->azimuth_rad(column));
      const double range = FormulaLidar::range_m(column, p.ring) + 2 * p.return_index;
      const float got_xyz[3] = {p.x_m, p.y_m, p.z_m};
      for (std::size_t k = 0; k < 3; ++k)
        ASSERT_NEAR(got_xyz[k], aim.origin_m[k] + range * aim.direction[k], step_m + 1e-5)
            << "column " << column << " row " << p.ring;
      ASSERT_EQ(p.remission, static_cast<float>(p.ring * 5 + p.return_index));
      second += p.return_index;
    }
    EXPECT_EQ(points.size() - second, (512u - 8) * kBeams);
    EXPECT_EQ(second, dual ? (512u - 8) * kBeams / 2 : 0u);
  }
}
INSTANTIATE_TEST_SUITE_P(Ouster, EveryProfile, testing::ValuesIn(kProfiles),
                         [](const auto& which) { return std::string(name_of(which.param)); });

TEST(OusterVirtual, HasTheWindowAndTheColumnsOfItsConfiguration) {
  VirtualSource source(parts_of({1024, 10}),
                       config_of("{config: {lidar_mode: 512x10, azimuth_window: [270000, 90000]}}").params);
  const auto got = run_virtual(source, config_of("{}"), milliseconds(260));
  ASSERT_EQ(got.size(), 2u);
  const auto points = points_of(got[1]);
  ASSERT_GT(points.size(), 0u);
  // Beams look up to 4.2 degrees beside their column, and the outermost columns are half a column outside.
  const double most_behind = std::sin((4.2 + 360.0 / 512) * M_PI / 180);
  for (const LidarPoint& p : points)
    ASSERT_GT(p.x_m, -most_behind * std::hypot(p.x_m, p.y_m) - 0.05) << "what lies behind";
  EXPECT_EQ(got[1]->stamp.validity, 0u);
  EXPECT_EQ((got[1]->stamp.t_capture - got[0]->stamp.t_capture).ns(), 100'000'000);
}

TEST(OusterVirtual, GivesImagesOfTheFramesThatItsPointsAreOf) {
  const auto run = [](const std::string& params, SampleKind kind) {
    VirtualSource source(parts_of(), config_of("{}").params);
    return run_virtual(source, config_of(params, kind), milliseconds(230));
  };
  const auto points = run("{}", SampleKind::point_cloud);
  const auto reflectivity = run("{field: reflectivity}", SampleKind::image);
  const auto signal = run("{}", SampleKind::image);
  const auto ranges = run("{}", SampleKind::range_image);
  ASSERT_EQ(points.size(), 2u);
  for (const auto* images : {&reflectivity, &signal, &ranges}) {
    ASSERT_EQ(images->size(), 2u);
    for (std::size_t i = 0; i < 2; ++i) {
      EXPECT_EQ((*images)[i]->stamp.t_capture, points[i]->stamp.t_capture);
      EXPECT_EQ((*images)[i]->stamp.sequence, points[i]->stamp.sequence);
    }
  }
  const auto* image = reflectivity[1]->as<ImageInfo>();
  ASSERT_NE(image, nullptr);
  EXPECT_EQ(image->format, PixelFormat::mono8);
  EXPECT_EQ(image->width_px, 512u);
  EXPECT_EQ(image->height_px, kBeams);
  ASSERT_EQ(reflectivity[1]->size_bytes, 512u * kBeams);
  ASSERT_NE(signal[1]->as<ImageInfo>(), nullptr);
  EXPECT_EQ(signal[1]->as<ImageInfo>()->format, PixelFormat::mono16);
  EXPECT_EQ(signal[1]->size_bytes, 512u * kBeams * 2);
  ASSERT_NE(ranges[1]->as<RangeImageInfo>(), nullptr);
  // Beams of the emulated sensor lie up to 8.4 degrees apart: 12 columns of 512.
  const Metadata m = SensorDevice::create(std::make_shared<FormulaLidar>())
                         ->metadata({Profile::single, {512, 10}, {0, 511}});
  const std::span<const std::byte> grey = reflectivity[1]->bytes(), metres = ranges[1]->bytes();
  std::size_t returns = 0;
  for (std::uint32_t row = 0; row < kBeams; ++row)
    for (std::uint32_t column = 0; column < 512; ++column) {
      const std::size_t at = row * 512 + (column + static_cast<std::uint32_t>(m.pixel_shift[row])) % 512;
      const double range = FormulaLidar::range_m(column, row);
      ASSERT_EQ(static_cast<int>(grey[at]), range == 0 ? 0 : static_cast<int>(row * 5));
      const float got = load_le<float>(metres, at * 4);
      if (range == 0) {
        ASSERT_TRUE(std::isnan(got));
      } else {
        ASSERT_NEAR(got, range + test::kOrigin_m, 0.0006) << "from the lidar's origin";
        ++returns;
      }
    }
  EXPECT_EQ(returns, (512u - 8) * kBeams);
}

TEST(OusterVirtual, RefusesAnImageThatItsProfileDoesNotHave) {
  VirtualSource source(parts_of(), config_of("{config: {udp_profile_lidar: RNG15_RFL8_NIR8}}").params);
  ASSERT_TRUE(source.configure(config_of("{field: signal}", SampleKind::image)));
  ArmContext context;
  context.virtual_time = true;
  const auto s = source.arm(context);
  ASSERT_FALSE(s);
  EXPECT_NE(s.error().text().find("field"), std::string::npos) << s.error().text();
  OusterSource range;
  EXPECT_FALSE(range.configure(config_of("{field: range, host: a}", SampleKind::image)));
  EXPECT_FALSE(range.configure(config_of("{field: signal, host: a}"))) << "points have a remission";
  EXPECT_FALSE(range.configure(config_of("{full_scale: 9, host: a}", SampleKind::image))) << "of Mono8";
}

TEST(OusterVirtual, PassesTheAngleOfPhaseLockAtTheFullSecond) {
  // Bench time 0 is a full second of UTC; 90 degrees is 384 of 512 columns after the frame's beginning.
  const auto first = [](const std::string& config) {
    VirtualSource source(parts_of(), config_of("{config: {" + config + "}}").params);
    const auto got = run_virtual(source, config_of("{}"), milliseconds(350));
    EXPECT_GE(got.size(), 2u);
    EXPECT_EQ((got[1]->stamp.t_capture - got[0]->stamp.t_capture).ns(), 100'000'000);
    return got[0]->stamp.t_capture.ns();
  };
  EXPECT_EQ(first("timestamp_mode: TIME_FROM_PTP_1588"), 0);
  const std::string lock = "timestamp_mode: TIME_FROM_PTP_1588, phase_lock_enable: true, phase_lock_offset: ";
  EXPECT_EQ(first(lock + "0"), 0);
  EXPECT_EQ(first(lock + "90000"), 25'000'000);
  EXPECT_EQ(first(lock + "180000"), 50'000'000);
}

TEST(OusterVirtual, RefusesALatencyThatCannotBe) {
  VirtualSource source(parts_of(), config_of("{}").params);
  auto config = config_of("{}");
  config.latency = milliseconds(90);
  ASSERT_TRUE(source.configure(config));
  ArmContext context;
  context.virtual_time = true;
  const auto s = source.arm(context);
  ASSERT_FALSE(s);
  EXPECT_NE(s.error().text().find("latency_ms"), std::string::npos) << s.error().text();
}

/// A recording of frames with one packet missing.
void record(const rigor::test::TemporaryDirectory& dir, std::uint64_t frames) {
  const auto lost = [](std::uint64_t frame, std::uint32_t slot) { return frame == 1 && slot == 3; };
  ASSERT_TRUE(test::record_sensor(dir.file("a.pcap"), dir.file("a.json"), {.frames = frames, .lost = lost}));
}

TEST(OusterRecording, IsReadFromItsFragmentsInVirtualTime) {
  rigor::test::TemporaryDirectory dir;
  record(dir, 3);
  OusterSource source;
  const auto got = run_virtual(
      source, config_of("{file: " + dir.file("a.pcap") + ", metadata: " + dir.file("a.json") + "}"),
      milliseconds(600));
  ASSERT_EQ(got.size(), 3u);
  EXPECT_EQ(got[0]->size_bytes / sizeof(LidarPoint), (512u - 8) * kBeams);
  EXPECT_EQ(got[1]->stamp.validity & kIncomplete, kIncomplete);
  EXPECT_EQ(got[2]->stamp.sequence, 2u);
  EXPECT_EQ(source.counters().packets_lost, 1u);
  EXPECT_EQ(source.counters().columns_lost, 16u);
  EXPECT_FALSE(source.health().connected) << "it has ended";
}

TEST(OusterRecording, IsReadAsImagesToo) {
  rigor::test::TemporaryDirectory dir;
  record(dir, 3);
  OusterSource source;
  const auto got = run_virtual(source,
                               config_of("{file: " + dir.file("a.pcap") +
                                             ", metadata: " + dir.file("a.json") + ", field: reflectivity}",
                                         SampleKind::image),
                               milliseconds(600));
  ASSERT_EQ(got.size(), 3u);
  EXPECT_EQ(got[0]->size_bytes, 512u * kBeams);
  EXPECT_EQ(source.describe().width_px, 512u);
  EXPECT_EQ(source.describe().height_px, kBeams);
  EXPECT_EQ(got[1]->stamp.validity & kIncomplete, kIncomplete);
  // Row 1 is a grey of 5 where there is a return; the lost packet leaves 16 columns black.
  const auto black = [&](std::size_t frame) {
    const auto row = got[frame]->bytes().subspan(512, 512);
    return std::count(row.begin(), row.end(), std::byte{0});
  };
  EXPECT_EQ(black(0), 8);
  EXPECT_EQ(black(1), 8 + 16) << "of the 8 without a return none is in it";
}

TEST(OusterRecording, NeedsMetadataOfItsOwnSensor) {
  rigor::test::TemporaryDirectory dir;
  record(dir, 1);
  OusterSource source;
  const auto alone = source.configure(config_of("{file: " + dir.file("a.pcap") + "}"));
  ASSERT_FALSE(alone);
  EXPECT_NE(alone.error().text().find("metadata"), std::string::npos);
  std::ifstream in(dir.file("a.json"));
  std::string text{std::istreambuf_iterator<char>(in), {}};
  text.replace(text.find("RNG19_RFL8_SIG16_NIR16", text.find("lidar_data_format")), 22, "RNG15_RFL8_NIR8");
  std::ofstream(dir.file("b.json")) << text;
  ASSERT_TRUE(source.configure(
      config_of("{file: " + dir.file("a.pcap") + ", metadata: " + dir.file("b.json") + "}")));
  const auto s = source.arm({});
  ASSERT_FALSE(s);
  EXPECT_NE(s.error().text().find("packets of 2304 bytes"), std::string::npos) << s.error().text();
}

TEST(OusterEmulator, ServesMetadataPointsAndItsImu) {
  Device device;
  auto s = device.start("", ", start_up_ms: 150");
  ASSERT_TRUE(s) << s.error().text();
  EXPECT_EQ(device.ask("GET", "/api/v1/sensor/metadata/sensor_info").status, 200);
  EXPECT_EQ(device.ask("GET", "/nothing").status, 404);
  OusterSource points, imu;
  ASSERT_TRUE(points.configure(config_of("{buffers: 32, " + device.host() + "}")));
  ASSERT_TRUE(imu.configure(config_of("{buffers: 64, " + device.host() + "}", SampleKind::imu)));
  s = points.arm({});  // waits until it is RUNNING
  ASSERT_TRUE(s) << s.error().text();
  s = imu.arm({});
  ASSERT_TRUE(s) << s.error().text();
  const BenchTime t0 = bench_now();
  ASSERT_TRUE(points.start(t0));
  ASSERT_TRUE(imu.start(t0));
  std::vector<SampleLease> clouds, readings;
  ASSERT_TRUE(poll_until(points, clouds, [&] { return clouds.size() >= 3; }));
  ASSERT_TRUE(poll_until(imu, readings, [&] { return readings.size() >= 5; }));
  for (std::size_t i = 0; i < clouds.size(); ++i) {
    if ((clouds[i]->stamp.validity & kIncomplete) == 0) {
      EXPECT_EQ(clouds[i]->size_bytes / sizeof(LidarPoint), (512u - 8) * kBeams);
    }
    if (i > 0) {
      EXPECT_EQ(clouds[i]->stamp.sequence, clouds[i - 1]->stamp.sequence + 1 + clouds[i]->stamp.lost_before);
    }
    EXPECT_LE(clouds[i]->stamp.t_capture.ns(), monotonic_now().ns());
  }
  EXPECT_NEAR(readings[0]->as<ImuSample>()->specific_force_mps2[2], 9.80665, 1e-6);
  EXPECT_EQ(points.counters().foreign, 0u);
  ASSERT_TRUE(points.stop());
  ASSERT_TRUE(imu.stop());
  ASSERT_TRUE(device.emulator->stop());
}

TEST(OusterSource, ConfiguresTheSensorAndFollowsWhenAnotherClientDoes) {
  Device device;
  // Sends elsewhere, and not at all.
  auto s = device.start(", udp_dest: 127.0.0.77, operating_mode: STANDBY");
  ASSERT_TRUE(s) << s.error().text();
  OusterSource source;
  ASSERT_TRUE(source.configure(config_of("{buffers: 32, " + device.host() + "}")));
  s = source.arm({});
  ASSERT_FALSE(s);
  EXPECT_NE(s.error().text().find("STANDBY"), std::string::npos) << s.error().text();
  ASSERT_TRUE(source.configure(config_of(
      "{buffers: 32, configure: {udp_dest: auto, operating_mode: NORMAL}, " + device.host() + "}")));
  s = source.arm({});
  ASSERT_TRUE(s) << s.error().text();
  ASSERT_TRUE(source.start(bench_now()));
  std::vector<SampleLease> got;
  ASSERT_TRUE(poll_until(source, got, [&] { return got.size() >= 2; }));
  // A channel that asks for what is there already leaves the sensor as it is.
  const std::string before = device.ask("GET", "/api/v1/sensor/metadata/sensor_info").body;
  OusterSource second;
  ASSERT_TRUE(second.configure(
      config_of("{configure: {udp_dest: auto, operating_mode: NORMAL}, " + device.host() + "}")));
  const auto as_it_is = second.arm({});
  ASSERT_TRUE(as_it_is) << as_it_is.error().text();
  ASSERT_TRUE(second.stop());
  EXPECT_EQ(device.ask("GET", "/api/v1/sensor/metadata/sensor_info").body, before);
  EXPECT_EQ(device.ask("POST", "/api/v1/sensor/config", R"({"azimuth_window": [270000, 90000]})").status,
            200);
  const auto windowed = [&] {
    return !got.empty() && got.back()->size_bytes / sizeof(LidarPoint) == (256u - 4) * kBeams;
  };
  ASSERT_TRUE(poll_until(source, got, windowed));
  EXPECT_EQ(source.counters().reinitialized, 1u);
  expect_numbered(got);
  // A parameter that the sensor does not take is an error of the rig.
  OusterSource wrong;
  ASSERT_TRUE(wrong.configure(config_of("{configure: {lidar_mode: 4096x5}, " + device.host() + "}")));
  const auto refused = wrong.arm({});
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, ErrorCode::bad_input);
  EXPECT_NE(refused.error().text().find("lidar_mode"), std::string::npos) << refused.error().text();
  ASSERT_TRUE(source.stop());
}

TEST(OusterSource, SharesTheSensorsPortWithOtherChannels) {
  Device device;
  ASSERT_TRUE(device.start());
  OusterSource points, signal, range;
  const std::string params = "{buffers: 32, " + device.host() + "}";
  ASSERT_TRUE(points.configure(config_of(params)));
  ASSERT_TRUE(signal.configure(config_of(params, SampleKind::image)));
  ASSERT_TRUE(range.configure(config_of(params, SampleKind::range_image)));
  for (OusterSource* s : {&points, &signal, &range}) {
    const auto armed = s->arm({});
    ASSERT_TRUE(armed) << armed.error().text();
  }
  EXPECT_EQ(signal.describe().width_px, 512u);
  EXPECT_EQ(range.describe().height_px, kBeams);
  const BenchTime t0 = bench_now();
  std::array<std::vector<SampleLease>, 3> got;
  const std::array<OusterSource*, 3> sources{&points, &signal, &range};
  for (OusterSource* s : sources) ASSERT_TRUE(s->start(t0));
  for (std::size_t i = 0; i < 3; ++i)
    ASSERT_TRUE(poll_until(*sources[i], got[i], [&] { return got[i].size() >= 3; }));
  // The same packets: frames have the same place in time, as far as the channels know the sensor's clock. A
  // channel that was armed later may lack the first of them.
  for (std::size_t i = 1; i < 3; ++i)
    for (std::size_t k = 0; k < 2; ++k)
      EXPECT_TRUE(std::any_of(got[0].begin(), got[0].end(),
                              [&](const SampleLease& cloud) {
                                return std::abs((got[i][k]->stamp.t_capture - cloud->stamp.t_capture).ns()) <
                                       5'000'000;
                              }))
          << i << " " << k;
  // One goes, the others stay; and where the sensor sends to another port, they follow.
  ASSERT_TRUE(signal.stop());
  const auto other = network::test::free_ports()[0];
  EXPECT_EQ(
      device.ask("POST", "/api/v1/sensor/config", R"({"udp_port_lidar": )" + std::to_string(other) + "}")
          .status,
      200);
  for (const std::size_t i : {0, 2})
    ASSERT_TRUE(poll_until(*sources[i], got[i], [&, before = got[i].size()] {
      return sources[i]->counters().reinitialized == 1 && got[i].size() >= before + 2;
    })) << sources[i]->counters().reinitialized;
  // The first one's port is free for others now.
  network::UdpReceiver free;
  EXPECT_TRUE(free.open("0.0.0.0", device.port[0], 65536));
  ASSERT_TRUE(points.stop());
  ASSERT_TRUE(range.stop());
}

TEST(OusterSource, PassesOverPacketsOfOtherSenders) {
  Device device;
  ASSERT_TRUE(device.start());
  OusterSource source;
  ASSERT_TRUE(source.configure(config_of("{buffers: 32, " + device.host() + "}")));
  const auto s = source.arm({});
  ASSERT_TRUE(s) << s.error().text();
  ASSERT_TRUE(source.start(bench_now()));
  std::vector<SampleLease> got;
  ASSERT_TRUE(poll_until(source, got, [&] { return !got.empty(); }));
  // A whole packet of the same sort, from another address.
  const auto m = fetch_metadata({"127.0.0.1", device.http, 0, -1}, monotonic_now() + seconds(10));
  ASSERT_TRUE(m);
  LidarPacketWriter packet(layout_of(*m));
  packet.set_header(60'000, m->initialization_id, 1);
  for (std::uint32_t i = 0; i < 16; ++i) packet.set_column(i, 1, static_cast<std::uint16_t>(i), true);
  const FileDescriptor other(socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0));
  sockaddr_in at{};
  at.sin_family = AF_INET;
  at.sin_addr.s_addr = htonl(0x7F000002);
  ASSERT_EQ(bind(other.get(), reinterpret_cast<sockaddr*>(&at), sizeof at), 0);
  at.sin_addr.s_addr = htonl(0x7F000001);
  at.sin_port = htons(device.port[0]);
  for (int i = 0; i < 5; ++i)
    EXPECT_GT(sendto(other.get(), packet.bytes().data(), packet.bytes().size(), 0,
                     reinterpret_cast<sockaddr*>(&at), sizeof at),
              0);
  const std::size_t before = got.size();
  ASSERT_TRUE(
      poll_until(source, got, [&] { return source.counters().foreign == 5 && got.size() >= before + 2; }));
  EXPECT_EQ(source.counters().clock_steps, 0u);
  ASSERT_TRUE(source.stop());
}

/// What an emulated sensor sends: the timestamp at which it is at `column`, of its first whole packets.
std::uint64_t timestamp_of_column(const std::string& config, std::uint32_t column) {
  Device device;
  network::UdpReceiver receiver;
  EXPECT_TRUE(receiver.open("127.0.0.1", device.port[0], 1 << 20, 65'507));
  const auto s = device.start(config);
  EXPECT_TRUE(s) << s.error().text();
  const auto m = fetch_metadata({"127.0.0.1", device.http, 0, -1}, monotonic_now() + seconds(10));
  EXPECT_TRUE(m);
  if (!s || !m) return 0;
  const PacketLayout layout = layout_of(*m);
  for (const MonotonicTime end = monotonic_now() + seconds(30); monotonic_now() < end;) {
    for (const auto& d : receiver.receive(read_epoch())) {
      PacketFault fault{};
      const auto packet = LidarPacket::parse(d.bytes, layout, fault);
      for (std::uint32_t i = 0; packet && i < packet->columns(); ++i)
        if (packet->column(i).measurement_id() == column) return packet->column(i).timestamp_ns();
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(1));  // the pace of polling, until the loop ends it
  }
  return 0;
}

TEST(OusterEmulator, CountsTimeByItsModeAndLocksItsPhase) {
  constexpr std::uint64_t kSecond = 1'000'000'000, kFrame = 100'000'000;
  const auto utc = [] { return static_cast<std::uint64_t>(realtime_now().ns()); };
  EXPECT_LT(timestamp_of_column("", 0), 60 * kSecond) << "since it was switched on";
  const std::uint64_t before = utc();
  const std::uint64_t tai = timestamp_of_column(
      ", timestamp_mode: TIME_FROM_PTP_1588, phase_lock_enable: true, phase_lock_offset: 90000", 384);
  EXPECT_GT(tai, before + 36 * kSecond);
  EXPECT_LT(tai, utc() + 37 * kSecond + kFrame);
  // Column 384 of 512 is at 90 degrees; a tenth of a second is a turn.
  EXPECT_EQ(tai % kFrame, 0u);
  const std::uint64_t pulses = timestamp_of_column(
      ", timestamp_mode: TIME_FROM_SYNC_PULSE_IN, phase_lock_enable: true, phase_lock_offset: 270000", 128);
  EXPECT_LT(pulses, 60 * kSecond);
  EXPECT_EQ(pulses % kFrame, 0u);
  const std::uint64_t gps = timestamp_of_column(
      ", timestamp_mode: TIME_FROM_SYNC_PULSE_IN, multipurpose_io_mode: INPUT_NMEA_UART", 0);
  EXPECT_LT(utc() - gps, 60 * kSecond);
}

TEST(OusterSource, SurvivesASensorThatGoesAndComes) {
  Device device;
  ASSERT_TRUE(device.start());
  OusterSource source;
  ASSERT_TRUE(source.configure(config_of("{buffers: 64, " + device.host() + "}")));
  const auto s = source.arm({});
  ASSERT_TRUE(s) << s.error().text();
  ASSERT_TRUE(source.start(bench_now()));
  std::vector<SampleLease> got;
  packet_lidar::test::expect_survival(
      source, got, [&] { return device.emulator->stop(); }, [&] { return device.start(); });
  ASSERT_TRUE(source.stop());
}

TEST(OusterSource, SaysWhenNobodyIsThere) {
  const auto port = network::test::free_ports();
  OusterSource source;
  ASSERT_TRUE(source.configure(
      config_of("{host: 127.0.0.1, tcp_port: 0, http_port: " + std::to_string(port[0]) + "}")));
  const auto s = source.arm({});
  ASSERT_FALSE(s);
  EXPECT_EQ(s.error().code, ErrorCode::not_found);
  ASSERT_TRUE(source.configure(config_of("{}")));
  const auto nothing = source.arm({});
  ASSERT_FALSE(nothing);
  EXPECT_NE(nothing.error().text().find("`host`"), std::string::npos);
  EXPECT_EQ(source.state(), ChannelState::configured);
}

TEST(OusterEmulator, AnswersTheOlderCommandsOfTcp) {
  Device device;
  const auto tcp = network::test::free_ports()[0];
  device.emulator->attach(parts_of());
  ASSERT_TRUE(device.emulator->configure(
      config_of("{http_port: 0, tcp_port: " + std::to_string(tcp) + ", config: {operating_mode: STANDBY}}")));
  ASSERT_TRUE(device.emulator->arm({}));
  ASSERT_TRUE(device.emulator->start(bench_now()));
  // Nobody at the port of HTTP: the metadata come by the older way.
  const auto closed = network::test::free_ports()[0];
  const auto m = fetch_metadata({"127.0.0.1", closed, tcp, -1}, monotonic_now() + seconds(10));
  ASSERT_TRUE(m) << m.error().text();
  EXPECT_EQ(m->status, "STANDBY");
  EXPECT_EQ(m->pixels_per_column, kBeams);
}

}  // namespace
}  // namespace rigor::ouster
