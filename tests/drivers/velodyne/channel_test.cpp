// The emulated device and its readers: in virtual time, over loopback by a plain socket, and killed in
// mid-run.
#include <gtest/gtest.h>
#include <poll.h>

#include <cstdlib>
#include <fstream>
#include <set>
#include <thread>

#include "drivers/velodyne/pcap_report.h"
#include "drivers/velodyne/velodyne_emulator.h"
#include "drivers/velodyne/velodyne_source.h"
#include "drivers/velodyne/velodyne_virtual_source.h"
#include "tests/drivers/network/free_ports.h"
#include "tests/drivers/velodyne/formula_lidar.h"

namespace rigor::velodyne {
namespace {

using packet_lidar::test::points_of;
using packet_lidar::test::run_virtual;
using test::FormulaLidar;

ChannelConfig config_of(const std::string& params, double rotation_hz = 10) {
  const Duration turn = seconds_from(1 / rotation_hz);
  return packet_lidar::test::channel_config(params, SampleKind::point_cloud, turn, turn + milliseconds(20));
}
DeviceParts parts_of(Model model, double rotation_hz, bool dual = false) {
  DeviceParts parts;
  parts.samples = std::make_shared<FormulaLidar>(model, rotation_hz, dual);
  return parts;
}
class EveryModel : public testing::TestWithParam<std::tuple<Model, double, bool>> {};

TEST_P(EveryModel, InVirtualTimeGivesWhatTheSimulatorMeasured) {
  const auto [model, hz, dual] = GetParam();
  const std::string keys =
      std::string("{model: ") + std::string(facts_of(model).key) + (dual ? ", returns: dual}" : "}");
  VirtualSource source(parts_of(model, hz, dual), config_of(keys).params);
  const auto got = run_virtual(source, config_of("{buffers: 16}", hz), milliseconds(480));
  ASSERT_GE(got.size(), static_cast<std::size_t>(0.45 * hz) - 1);
  for (std::size_t i = 0; i < got.size(); ++i) {
    const Stamp& stamp = got[i]->stamp;
    EXPECT_EQ(stamp.sequence, i);
    EXPECT_EQ(stamp.validity, 0u);
    // A revolution begins with the first sequence past azimuth 0.
    const double late_ns = static_cast<double>(stamp.t_capture.ns()) - static_cast<double>(i) * 1e9 / hz;
    EXPECT_GE(late_ns, -1000);
    EXPECT_LE(late_ns, static_cast<double>(facts_of(model).sequence_ns) + 1000);
    const auto points = points_of(got[i]);
    std::size_t second = 0;
    for (const LidarPoint& p : points) {
      // Where the rotor was when this laser fired.
      const double t_s = static_cast<double>(stamp.t_capture.ns() + p.t_offset_ns) * 1e-9;
      const double a = -2 * std::numbers::pi * hz * t_s;
      const double error = std::remainder(std::atan2(p.y_m, p.x_m) - a, 2 * std::numbers::pi);
      // The packet's hundredths of a degree, and its rate from two of them.
      ASSERT_NEAR(error, 0, 2.7e-4) << "ring " << p.ring << " at " << p.t_offset_ns;
      const double offset = factory_calibration(model).lasers[p.ring].vertical_offset_m;
      const double range = std::hypot(static_cast<double>(p.x_m), static_cast<double>(p.y_m),
                                      static_cast<double>(p.z_m) - offset);
      // At the edges of the sector without returns, the microseconds of the packet decide.
      if (FormulaLidar::range_m(a + 3e-4, p.ring) == 0 || FormulaLidar::range_m(a - 3e-4, p.ring) == 0)
        continue;
      const double expected = FormulaLidar::range_m(a, p.ring) + 2 * p.return_index;
      // The formula changes by 8 m per radian.
      ASSERT_NEAR(range, expected, 8e-4 + 2e-3) << "ring " << p.ring << " at " << p.t_offset_ns;
      ASSERT_EQ(p.remission, static_cast<float>(p.ring * 5 + p.return_index));
      second += p.return_index;
    }
    const double firings =
        1e9 / hz / static_cast<double>(facts_of(model).sequence_ns) * facts_of(model).lasers;
    // A sector of 0.34 rad of the turn has no returns.
    EXPECT_NEAR(static_cast<double>(points.size() - second) / firings, 1 - 0.34 / (2 * std::numbers::pi),
                2e-3);
    EXPECT_NEAR(static_cast<double>(second), dual ? static_cast<double>(points.size() - second) / 4 : 0.0,
                64.0);
  }
}
INSTANTIATE_TEST_SUITE_P(Velodyne, EveryModel,
                         testing::Values(std::tuple{Model::vlp16, 10.0, false},
                                         std::tuple{Model::vlp16, 20.0, true},
                                         std::tuple{Model::hdl32e, 10.0, false},
                                         std::tuple{Model::hdl32e, 5.0, true}));

TEST(VelodyneVirtual, RunsRepeatByteForByte) {
  std::vector<std::vector<LidarPoint>> first;
  for (int round = 0; round < 2; ++round) {
    VirtualSource source(parts_of(Model::vlp16, 10), config_of("{}").params);
    const auto got = run_virtual(source, config_of("{buffers: 8}"), milliseconds(350));
    ASSERT_EQ(got.size(), 3u);
    for (std::size_t i = 0; i < got.size(); ++i) {
      const auto p = points_of(got[i]);
      if (round == 0)
        first.push_back(p);
      else
        EXPECT_TRUE(p.size() == first[i].size() &&
                    std::memcmp(p.data(), first[i].data(), p.size() * sizeof p[0]) == 0);
    }
  }
}

TEST(VelodyneVirtual, RefusesASensorModelOfAnotherScannerAndALatencyThatCannotBe) {
  ArmContext context;
  context.virtual_time = true;
  VirtualSource other(parts_of(Model::hdl32e, 10), config_of("{model: vlp16}").params);
  ASSERT_TRUE(other.configure(config_of("{}")));
  auto s = other.arm(context);
  ASSERT_FALSE(s);
  EXPECT_NE(s.error().text().find("32 beams"), std::string::npos) << s.error().text();
  VirtualSource hasty(parts_of(Model::vlp16, 10), config_of("{}").params);
  auto config = config_of("{}");
  config.latency = milliseconds(90);
  ASSERT_TRUE(hasty.configure(config));
  s = hasty.arm(context);
  ASSERT_FALSE(s);
  EXPECT_NE(s.error().text().find("latency_ms"), std::string::npos) << s.error().text();
}

/// An emulator that serves now.
struct Device {
  std::array<std::uint16_t, 2> port = network::test::free_ports();
  std::unique_ptr<VelodyneEmulator> emulator;
  [[nodiscard]] std::string keys() const {
    return "port: " + std::to_string(port[0]) + ", position_port: " + std::to_string(port[1]);
  }
  Status start(const std::string& more = "", Model model = Model::vlp16, double hz = 10, bool dual = false) {
    emulator = std::make_unique<VelodyneEmulator>();
    emulator->attach(parts_of(model, hz, dual));
    if (auto s = emulator->configure(config_of("{" + keys() + more + "}")); !s) return s;
    if (auto s = emulator->arm({}); !s) return s;
    return emulator->start(bench_now());
  }
};

TEST(VelodyneEmulator, SendsEvenPacketsAndPositionsAndWritesThem) {
  rigor::test::TemporaryDirectory dir;
  const std::string file = dir.file("sent.pcap");
  Device device;
  network::UdpReceiver data, position;
  ASSERT_TRUE(data.open("127.0.0.1", device.port[0], 1 << 20));
  ASSERT_TRUE(position.open("127.0.0.1", device.port[1], 1 << 16));
  auto s = device.start(", latitude_deg: 48.2, pcap: " + file);
  ASSERT_TRUE(s) << s.error().text();
  std::vector<std::uint32_t> times, azimuths;
  std::size_t positions = 0;
  const MonotonicTime until = monotonic_now() + seconds(20);
  while (times.size() < 754 && monotonic_now() < until) {
    pollfd p[2] = {{data.fd(), POLLIN, 0}, {position.fd(), POLLIN, 0}};
    (void)::poll(p, 2, 100);
    for (const auto& d : data.receive(read_epoch())) {
      PacketFault fault{};
      const auto packet = DataPacket::parse(d.bytes, fault);
      ASSERT_TRUE(packet) << text_of(fault);
      EXPECT_EQ(packet->product(), 0x22);
      times.push_back(packet->timestamp_us());
      for (std::size_t b = 0; b < kBlocks; ++b) azimuths.push_back(packet->azimuth_cdeg(b));
    }
    for (const auto& d : position.receive(read_epoch())) {
      const auto packet = parse_position(d.bytes);
      ASSERT_TRUE(packet);
      const auto rmc = parse_rmc(packet->nmea);
      ASSERT_TRUE(rmc) << packet->nmea;
      EXPECT_NEAR(rmc->latitude_deg, 48.2, 1e-5);
      EXPECT_EQ(packet->pps, PpsStatus::locked);
      ++positions;
    }
  }
  const std::uint64_t given_up = device.emulator->health().lost;
  ASSERT_TRUE(device.emulator->stop());
  ASSERT_GE(times.size(), 754u);
  std::uint64_t missing = 0;
  for (std::size_t i = 1; i < times.size(); ++i) {
    const std::uint32_t step = (times[i] + kHour_us - times[i - 1]) % kHour_us;
    const std::uint32_t packets = (step + 663) / 1327;
    EXPECT_NEAR(step, packets * 1327.104, 1.01) << "device time, of the whole microseconds";
    missing += packets - 1;
  }
  EXPECT_LE(missing, given_up) << "packets that were not sent and not counted";
  if (missing == 0) {
    for (std::size_t i = 1; i < azimuths.size(); ++i)
      EXPECT_NEAR((azimuths[i] + kTurn_cdeg - azimuths[i - 1]) % kTurn_cdeg, 39.813, 1.0)
          << "10 Hz · 110.592 µs, rounded twice";
  }
  EXPECT_NEAR(static_cast<double>(positions), 144.5, 30 + static_cast<double>(given_up));

  const auto report = inspect_pcap(file);
  ASSERT_TRUE(report) << report.error().text();
  EXPECT_EQ(report->model_by_timing, Model::vlp16);
  EXPECT_EQ(report->malformed, 0u);
  EXPECT_GE(report->data_packets, times.size());
  EXPECT_EQ(report->data_packets, device.emulator->health().received);
  EXPECT_NEAR(report->rotation_hz, 10, 1e-3);
  // Another program reads what was written, checksums included.
  if (std::system("tshark --version > /dev/null 2>&1") != 0) return;
  const std::string out = dir.file("tshark.txt");
  const std::string command =
      "tshark -r " + file + " -o ip.check_checksum:TRUE -o udp.check_checksum:TRUE -Y '" +
      "_ws.malformed || ip.checksum.status == 0 || udp.checksum.status == 0' > " + out +
      " 2>/dev/null && tshark -r " + file + " -Y 'udp.length == 1214' 2>/dev/null | wc -l >> " + out;
  ASSERT_EQ(std::system(command.c_str()), 0);
  std::ifstream in(out);
  std::uint64_t counted = 0;
  in >> counted;
  EXPECT_EQ(counted, report->data_packets) << "tshark found malformed frames, or another number of packets";
}

/// Measures a turn of 0.05 s in 0.13 s.
class SlowLidar final : public SampleProvider {
 public:
  Geometry geometry() const override { return lidar_.geometry(); }
  const models::LidarScan* scan() const override { return lidar_.scan(); }
  Status capture(const Request& r, Sample& sample) override {
    std::this_thread::sleep_for(std::chrono::milliseconds(130));
    return lidar_.capture(r, sample);
  }

 private:
  test::FormulaLidar lidar_{Model::vlp16, 20};
};

// Each measurement came too late before, and nothing ever left.
TEST(VelodyneEmulator, OnASlowMachineSendsTheRevolutionsThatItCanMeasure) {
  Device device;
  device.emulator = std::make_unique<VelodyneEmulator>();
  DeviceParts parts;
  parts.samples = std::make_shared<SlowLidar>();
  device.emulator->attach(std::move(parts));
  ASSERT_TRUE(device.emulator->configure(config_of("{" + device.keys() + "}")));
  ASSERT_TRUE(device.emulator->arm({}));
  const auto s = device.emulator->start(bench_now());
  ASSERT_TRUE(s) << s.error().text();
  // The packets of at least five revolutions, 37 each; and most are left out.
  for (int i = 0; i < 400 && device.emulator->health().received < 5 * 37; ++i)
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
  EXPECT_GE(device.emulator->health().received, 5u * 37);
  EXPECT_GT(device.emulator->health().lost, 37u);
  ASSERT_TRUE(device.emulator->stop());
}

TEST(VelodyneSource, TellsOfAProductByteThatLies) {
  Device device;
  ASSERT_TRUE(device.start(", product: 0x21"));
  for (const std::string model : {"auto", "vlp16"}) {
    VelodyneSource source;
    ASSERT_TRUE(source.configure(config_of("{model: " + model + ", " + device.keys() + "}")));
    const auto s = source.arm({});
    ASSERT_TRUE(s) << s.error().text();
    ASSERT_EQ(source.warnings().size(), 1u);
    EXPECT_NE(source.warnings()[0].find("HDL-32E"), std::string::npos) << source.warnings()[0];
    ASSERT_TRUE(source.stop());
  }
}

TEST(VelodyneSource, SaysWhenNobodySends) {
  const auto port = network::test::free_ports();
  VelodyneSource source;
  ASSERT_TRUE(source.configure(config_of("{port: " + std::to_string(port[0]) + ", position_port: 0}")));
  const auto s = source.arm({});
  ASSERT_FALSE(s);
  EXPECT_EQ(s.error().code, ErrorCode::unavailable);
  EXPECT_EQ(source.state(), ChannelState::configured);
}

TEST(VelodyneSource, SurvivesADeviceThatGoesAndComesAndCountsWhatItMissed) {
  Device device;
  ASSERT_TRUE(device.start());
  VelodyneSource source;
  ASSERT_TRUE(source.configure(config_of("{buffers: 64, time: device, " + device.keys() + "}")));
  const auto armed = source.arm({});
  ASSERT_TRUE(armed) << armed.error().text();
  ASSERT_TRUE(source.start(bench_now()));
  std::vector<SampleLease> got;
  const std::size_t before = packet_lidar::test::expect_survival(
      source, got, [&] { return device.emulator->stop(); }, [&] { return device.start(); });
  ASSERT_LT(before, got.size());
  // A second and more away: ten revolutions and more, by the device's own time.
  std::uint64_t lost = 0;
  for (std::size_t i = 1; i < got.size(); ++i) lost += got[i]->stamp.lost_before;
  EXPECT_GE(lost, 8u);
  const double away_s = (got[before]->stamp.t_capture - got[before - 1]->stamp.t_capture).seconds();
  EXPECT_NEAR(static_cast<double>(got[before]->stamp.lost_before), away_s * 10 - 1, 1.5);
  EXPECT_GT(source.counters().packets_lost, 500u);
  EXPECT_GT(source.counters().position_packets, 0u);
  ASSERT_TRUE(source.stop());
}

TEST(VelodyneSource, TakesPacketsOfItsSenderAlone) {
  Device device;
  ASSERT_TRUE(device.start());
  VelodyneSource source;
  ASSERT_TRUE(source.configure(config_of("{from: 127.0.0.9, " + device.keys() + "}")));
  const auto s = source.arm({});
  ASSERT_FALSE(s);
  EXPECT_NE(s.error().text().find("127.0.0.9"), std::string::npos);
}

}  // namespace
}  // namespace rigor::velodyne
