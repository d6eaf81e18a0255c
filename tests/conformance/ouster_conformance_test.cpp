// An Ouster: in virtual time by its stand-in, over loopback by the emulator, and its IMU.
#include "drivers/ouster/ouster_emulator.h"
#include "drivers/ouster/ouster_source.h"
#include "drivers/ouster/ouster_virtual_source.h"
#include "tests/conformance/lidar_conformance.h"
#include "tests/drivers/network/free_ports.h"
#include "tests/drivers/ouster/record_sensor.h"

namespace rigor::conformance {
namespace {

constexpr ouster::LidarMode kMode{512, 20};

struct Ouster {
  using Emulator = ouster::OusterEmulator;
  using LiveSource = ouster::OusterSource;
  using VirtualSource = ouster::VirtualSource;

  static DeviceParts parts() {
    DeviceParts p;
    p.samples = std::make_shared<ouster::test::FormulaLidar>(kMode);
    return p;
  }
  static ChannelConfig config(const std::string& params, SampleKind kind) {
    return packet_lidar::test::channel_config(params, kind, milliseconds(kind == SampleKind::imu ? 10 : 50),
                                              milliseconds(80));
  }
  static std::string emulator_keys() {
    const auto ports = network::test::free_ports();
    return "tcp_port: 0, http_port: 0, config: {udp_port_lidar: " + std::to_string(ports[0]) +
           ", udp_port_imu: " + std::to_string(ports[1]) + "}";
  }
  static std::string source_keys(const Emulator& emulator, const std::string&) {
    return "host: 127.0.0.1, http_port: " + std::to_string(emulator.http_port());
  }
  static std::string record(const test::TemporaryDirectory& directory) {
    const std::string pcap = directory.file("a.pcap"), metadata = directory.file("a.json");
    EXPECT_TRUE(ouster::test::record_sensor(pcap, metadata, {.frames = 80, .mode = kMode}));
    return "file: " + pcap + ", metadata: " + metadata;
  }
};

using Virtual = VirtualLidar<Ouster>;
using VirtualImage = VirtualLidar<Ouster, SampleKind::image>;
using Loopback = LoopbackLidar<Ouster>;
using Imu = LoopbackLidar<Ouster, SampleKind::imu>;
using VirtualRecording = RecordedLidar<Ouster>;

INSTANTIATE_TEST_SUITE_P(Ouster, SourceConformance,
                         testing::Values(under_test<Virtual>("virtual_time"),
                                         under_test<VirtualImage>("image_in_virtual_time"),
                                         under_test<Loopback>("loopback"), under_test<Imu>("imu_loopback"),
                                         under_test<VirtualRecording>("recording_in_virtual_time")),
                         name_of_case);
INSTANTIATE_TEST_SUITE_P(Ouster, LifecycleConformance,
                         testing::Values(channel_under_test<EmulatedLidar<Ouster>>("emulator")),
                         name_of_channel_case);

}  // namespace
}  // namespace rigor::conformance
