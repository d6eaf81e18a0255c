// A Livox Mid-360: in virtual time by its stand-in, over loopback by the emulator, and its inertial unit.
#include "drivers/livox/livox_emulator.h"
#include "drivers/livox/livox_source.h"
#include "drivers/livox/livox_virtual_source.h"
#include "drivers/network/pcap_file.h"
#include "tests/conformance/lidar_conformance.h"
#include "tests/drivers/livox/made_livox.h"
#include "tests/drivers/network/free_ports.h"

namespace rigor::conformance {
namespace {

struct Livox {
  using Emulator = livox::LivoxEmulator;
  using LiveSource = livox::LivoxSource;
  using VirtualSource = livox::VirtualSource;

  static DeviceParts parts() {
    DeviceParts p;
    p.samples = std::make_shared<livox::test::FormulaMid360>();
    return p;
  }
  static ChannelConfig config(const std::string& params, SampleKind kind) {
    return packet_lidar::test::channel_config(params, kind, milliseconds(kind == SampleKind::imu ? 5 : 50),
                                              milliseconds(80));
  }
  static std::string emulator_keys() {
    return "lidar_ports: false, command_port: 0, search_port: 0, point_port: 0, imu_port: 0, state_port: 0";
  }
  static std::string source_keys(const Emulator& emulator, const std::string&) {
    return "host: 127.0.0.1, command_port: " + std::to_string(emulator.command_port()) +
           ", port: " + std::to_string(network::test::free_ports()[0]);
  }
  static std::string record(const test::TemporaryDirectory& directory) {
    auto writer = network::PcapWriter::create(directory.file("a.pcap"));
    EXPECT_TRUE(writer);
    for (std::uint64_t j = 0; writer && j < 8400; ++j) {
      const auto bytes = livox::test::plain_packet(j);
      writer->write(RealtimeTime(1'700'000'000'000'000'000 + livox::Mid360Device::filled(j).ns()),
                    {1, 1, livox::kPointPort, livox::kHostPointPort, bytes});
    }
    return "file: " + directory.file("a.pcap");
  }
};

using Virtual = VirtualLidar<Livox>;
using VirtualImu = VirtualLidar<Livox, SampleKind::imu, 64>;
using Loopback = LoopbackLidar<Livox>;
using Imu = LoopbackLidar<Livox, SampleKind::imu>;
using VirtualRecording = RecordedLidar<Livox>;

INSTANTIATE_TEST_SUITE_P(Livox, SourceConformance,
                         testing::Values(under_test<Virtual>("virtual_time"),
                                         under_test<VirtualImu>("imu_in_virtual_time"),
                                         under_test<Loopback>("loopback"), under_test<Imu>("imu_loopback"),
                                         under_test<VirtualRecording>("recording_in_virtual_time")),
                         name_of_case);
INSTANTIATE_TEST_SUITE_P(Livox, LifecycleConformance,
                         testing::Values(channel_under_test<EmulatedLidar<Livox>>("emulator")),
                         name_of_channel_case);

}  // namespace
}  // namespace rigor::conformance
