// A Velodyne: in virtual time by its stand-in, over loopback by the emulator, and from a recording of it.
#include "drivers/velodyne/velodyne_emulator.h"
#include "drivers/velodyne/velodyne_source.h"
#include "drivers/velodyne/velodyne_virtual_source.h"
#include "tests/conformance/lidar_conformance.h"
#include "tests/drivers/network/free_ports.h"
#include "tests/drivers/velodyne/formula_lidar.h"

namespace rigor::conformance {
namespace {

struct Velodyne {
  using Emulator = velodyne::VelodyneEmulator;
  using LiveSource = velodyne::VelodyneSource;
  using VirtualSource = velodyne::VirtualSource;

  static DeviceParts parts() {
    DeviceParts p;
    p.samples = std::make_shared<velodyne::test::FormulaLidar>(velodyne::Model::vlp16, 20);
    return p;
  }
  static ChannelConfig config(const std::string& params, SampleKind kind) {
    return packet_lidar::test::channel_config(params, kind, milliseconds(50), milliseconds(80));
  }
  static std::string emulator_keys() {
    const auto ports = network::test::free_ports();
    return "port: " + std::to_string(ports[0]) + ", position_port: " + std::to_string(ports[1]);
  }
  static std::string source_keys(const Emulator&, const std::string& emulator_keys) { return emulator_keys; }
  static std::string record(const test::TemporaryDirectory& directory) {
    velodyne::test::record_rotor(directory.file("a.pcap"), 20, 754 * 4);
    return "file: " + directory.file("a.pcap");
  }
};

using VirtualRecording = RecordedLidar<Velodyne>;
using WallRecording = RecordedLidar<Velodyne, false>;

INSTANTIATE_TEST_SUITE_P(Velodyne, SourceConformance,
                         testing::Values(under_test<VirtualLidar<Velodyne>>("virtual_time"),
                                         under_test<LoopbackLidar<Velodyne>>("loopback"),
                                         under_test<VirtualRecording>("recording_in_virtual_time"),
                                         under_test<WallRecording>("recording")),
                         name_of_case);
INSTANTIATE_TEST_SUITE_P(Velodyne, LifecycleConformance,
                         testing::Values(channel_under_test<EmulatedLidar<Velodyne>>("emulator")),
                         name_of_channel_case);

}  // namespace
}  // namespace rigor::conformance
