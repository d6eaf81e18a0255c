// A Livox Mid-360: in virtual time by its stand-in, over loopback by the emulator, and its inertial unit.
#include "drivers/livox/livox_emulator.h"
#include "drivers/livox/livox_source.h"
#include "drivers/livox/livox_virtual_source.h"
#include "drivers/network/pcap_file.h"
#include "sensor-hal/conformance/conformance.h"
#include "tests/drivers/livox/made_livox.h"
#include "tests/drivers/network/free_ports.h"
#include "tests/sensor-hal/channel/test_sources.h"

namespace rigor::conformance {
namespace {

ChannelConfig config_of(const std::string& params, SampleKind kind = SampleKind::point_cloud) {
  ChannelConfig c = test::image_config(params, kind == SampleKind::imu ? milliseconds(5) : milliseconds(50),
                                       milliseconds(80), "top");
  c.kind = kind;
  return c;
}
DeviceParts parts() {
  DeviceParts p;
  p.samples = std::make_shared<livox::test::FormulaMid360>();
  return p;
}

class Virtual : public SourceUnderTest {
 public:
  std::unique_ptr<Source> make() override {
    return std::make_unique<livox::VirtualSource>(parts(), config_of("{}").params);
  }
  ChannelConfig config() override { return config_of("{buffers: 8}"); }
  ChannelConfig config_with_unknown_key() override { return config_of("{no_such_key: 1}"); }
  std::size_t slots() const override { return 8; }
};
class VirtualImu : public Virtual {
 public:
  ChannelConfig config() override { return config_of("{buffers: 64}", SampleKind::imu); }
  ChannelConfig config_with_unknown_key() override { return config_of("{no_such_key: 1}", SampleKind::imu); }
  std::size_t slots() const override { return 64; }
};

/// An emulator at ports of its own.
class Loopback : public SourceUnderTest {
 public:
  explicit Loopback(SampleKind kind = SampleKind::point_cloud) : kind_(kind) {
    emulator_.attach(parts());
    const auto port = network::test::free_ports()[0];
    const auto first_error = [&]() -> Status {
      if (auto s = emulator_.configure(config_of("{lidar_ports: false, command_port: 0, search_port: 0, "
                                                 "point_port: 0, imu_port: 0, state_port: 0}"));
          !s)
        return s;
      if (auto s = emulator_.arm({}); !s) return s;
      keys_ = "buffers: 8, host: 127.0.0.1, command_port: " + std::to_string(emulator_.command_port()) +
              ", port: " + std::to_string(port);
      return emulator_.start(bench_now());
    };
    if (auto s = first_error(); !s) problem_ = s.error().text();
  }
  ~Loopback() override { (void)emulator_.stop(); }
  bool virtual_time() const override { return false; }
  Duration settle() const override { return seconds(1); }
  std::size_t slots() const override { return 8; }
  std::unique_ptr<Source> make() override {
    EXPECT_EQ(problem_, "");
    return std::make_unique<livox::LivoxSource>();
  }
  ChannelConfig config() override { return config_of("{" + keys_ + "}", kind_); }
  ChannelConfig config_with_unknown_key() override {
    return config_of("{no_such_key: 1, " + keys_ + "}", kind_);
  }

 private:
  SampleKind kind_;
  livox::LivoxEmulator emulator_;
  std::string keys_, problem_;
};
class Imu : public Loopback {
 public:
  Imu() : Loopback(SampleKind::imu) {}
};

/// Four seconds of a device.
class VirtualRecording : public SourceUnderTest {
 public:
  VirtualRecording() {
    auto writer = network::PcapWriter::create(directory_.file("a.pcap"));
    if (!writer) return;
    for (std::uint64_t j = 0; j < 8400; ++j) {
      const auto bytes = livox::test::plain_packet(j);
      writer->write(RealtimeTime(1'700'000'000'000'000'000 + livox::Mid360Device::filled(j).ns()),
                    {1, 1, livox::kPointPort, livox::kHostPointPort, bytes});
    }
  }
  std::unique_ptr<Source> make() override { return std::make_unique<livox::LivoxSource>(); }
  std::size_t slots() const override { return 8; }
  ChannelConfig config() override { return config_of("{buffers: 8, " + keys() + "}"); }
  ChannelConfig config_with_unknown_key() override { return config_of("{no_such_key: 1, " + keys() + "}"); }

 private:
  std::string keys() { return "file: " + directory_.file("a.pcap"); }
  test::TemporaryDirectory directory_;
};

INSTANTIATE_TEST_SUITE_P(Livox, SourceConformance,
                         testing::Values(under_test<Virtual>("virtual_time"),
                                         under_test<VirtualImu>("imu_in_virtual_time"),
                                         under_test<Loopback>("loopback"), under_test<Imu>("imu_loopback"),
                                         under_test<VirtualRecording>("recording_in_virtual_time")),
                         name_of_case);

class Emulated final : public ChannelUnderTest {
 public:
  std::unique_ptr<Channel> make() override {
    auto emulator = std::make_unique<livox::LivoxEmulator>();
    emulator->attach(parts());
    return emulator;
  }
  ChannelConfig config() override { return config_of("{" + keys() + "}"); }
  ChannelConfig config_with_unknown_key() override { return config_of("{no_such_key: 1, " + keys() + "}"); }

 private:
  static std::string keys() {
    const auto ports = network::test::free_ports();
    return "lidar_ports: false, command_port: 0, search_port: 0, state_port: 0, point_port: " +
           std::to_string(ports[0]) + ", imu_port: " + std::to_string(ports[1]);
  }
};
INSTANTIATE_TEST_SUITE_P(Livox, LifecycleConformance,
                         testing::Values(channel_under_test<Emulated>("emulator")), name_of_channel_case);

}  // namespace
}  // namespace rigor::conformance
