// An Ouster: in virtual time by its stand-in, over loopback by the emulator, and its IMU.
#include "drivers/ouster/ouster_emulator.h"
#include "drivers/ouster/ouster_source.h"
#include "drivers/ouster/ouster_virtual_source.h"
#include "sensor-hal/conformance/conformance.h"
#include "tests/drivers/network/free_ports.h"
#include "tests/drivers/ouster/record_sensor.h"
#include "tests/sensor-hal/channel/test_sources.h"

namespace rigor::conformance {
namespace {

using ouster::LidarMode;
using ouster::test::FormulaLidar;

constexpr LidarMode kMode{512, 20};

ChannelConfig config_of(const std::string& params, SampleKind kind = SampleKind::point_cloud) {
  ChannelConfig c = test::image_config(params, kind == SampleKind::imu ? milliseconds(10) : milliseconds(50),
                                       milliseconds(80), "top");
  c.kind = kind;
  return c;
}
DeviceParts parts() {
  DeviceParts p;
  p.samples = std::make_shared<FormulaLidar>(kMode);
  return p;
}

class Virtual : public SourceUnderTest {
 public:
  std::unique_ptr<Source> make() override {
    return std::make_unique<ouster::VirtualSource>(parts(), config_of("{}").params);
  }
  ChannelConfig config() override { return config_of("{buffers: 8}"); }
  ChannelConfig config_with_unknown_key() override { return config_of("{no_such_key: 1}"); }
  std::size_t slots() const override { return 8; }
};

class VirtualImage final : public Virtual {
 public:
  ChannelConfig config() override { return config_of("{buffers: 8}", SampleKind::image); }
  ChannelConfig config_with_unknown_key() override {
    return config_of("{no_such_key: 1}", SampleKind::image);
  }
};

/// An emulator at ports of its own.
class Loopback : public SourceUnderTest {
 public:
  explicit Loopback(SampleKind kind = SampleKind::point_cloud) : kind_(kind) {
    emulator_.attach(parts());
    const auto ports = network::test::free_ports();
    const auto first_error = [&]() -> Status {
      if (auto s = emulator_.configure(
              config_of("{tcp_port: 0, http_port: 0, config: {udp_port_lidar: " + std::to_string(ports[0]) +
                        ", udp_port_imu: " + std::to_string(ports[1]) + "}}"));
          !s)
        return s;
      if (auto s = emulator_.arm({}); !s) return s;
      keys_ = "buffers: 8, host: 127.0.0.1, http_port: " + std::to_string(emulator_.http_port());
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
    return std::make_unique<ouster::OusterSource>();
  }
  ChannelConfig config() override { return config_of("{" + keys_ + "}", kind_); }
  ChannelConfig config_with_unknown_key() override {
    return config_of("{no_such_key: 1, " + keys_ + "}", kind_);
  }

 private:
  SampleKind kind_;
  ouster::OusterEmulator emulator_;
  std::string keys_, problem_;
};
class Imu : public Loopback {
 public:
  Imu() : Loopback(SampleKind::imu) {}
};

/// Four seconds of a sensor.
class VirtualRecording : public SourceUnderTest {
 public:
  VirtualRecording() {
    EXPECT_TRUE(
        ouster::test::record_sensor(directory_.file("a.pcap"), directory_.file("a.json"), {80, kMode, {}}));
  }
  std::unique_ptr<Source> make() override { return std::make_unique<ouster::OusterSource>(); }
  std::size_t slots() const override { return 8; }
  ChannelConfig config() override { return config_of("{buffers: 8, " + keys() + "}"); }
  ChannelConfig config_with_unknown_key() override { return config_of("{no_such_key: 1, " + keys() + "}"); }

 private:
  std::string keys() {
    return "file: " + directory_.file("a.pcap") + ", metadata: " + directory_.file("a.json");
  }
  test::TemporaryDirectory directory_;
};

INSTANTIATE_TEST_SUITE_P(Ouster, SourceConformance,
                         testing::Values(under_test<Virtual>("virtual_time"),
                                         under_test<VirtualImage>("image_in_virtual_time"),
                                         under_test<Loopback>("loopback"), under_test<Imu>("imu_loopback"),
                                         under_test<VirtualRecording>("recording_in_virtual_time")),
                         name_of_case);

class Emulated final : public ChannelUnderTest {
 public:
  std::unique_ptr<Channel> make() override {
    auto emulator = std::make_unique<ouster::OusterEmulator>();
    emulator->attach(parts());
    return emulator;
  }
  ChannelConfig config() override { return config_of("{" + keys() + "}"); }
  ChannelConfig config_with_unknown_key() override { return config_of("{no_such_key: 1, " + keys() + "}"); }

 private:
  static std::string keys() {
    const auto ports = network::test::free_ports();
    return "tcp_port: 0, http_port: 0, config: {udp_port_lidar: " + std::to_string(ports[0]) +
           ", udp_port_imu: " + std::to_string(ports[1]) + "}";
  }
};
INSTANTIATE_TEST_SUITE_P(Ouster, LifecycleConformance,
                         testing::Values(channel_under_test<Emulated>("emulator")), name_of_channel_case);

}  // namespace
}  // namespace rigor::conformance
