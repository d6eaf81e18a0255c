// A Velodyne: in virtual time by its stand-in, over loopback by the emulator, and from a recording of it.
#include "drivers/velodyne/velodyne_emulator.h"
#include "drivers/velodyne/velodyne_source.h"
#include "drivers/velodyne/velodyne_virtual_source.h"
#include "sensor-hal/conformance/conformance.h"
#include "tests/drivers/velodyne/formula_lidar.h"
#include "tests/sensor-hal/channel/test_sources.h"

namespace rigor::conformance {
namespace {

using velodyne::Model;
using velodyne::test::FormulaLidar;

ChannelConfig cloud_config(const std::string& params, Duration period = milliseconds(50),
                           Duration latency = milliseconds(80)) {
  ChannelConfig c = test::image_config(params, period, latency, "top");
  c.kind = SampleKind::point_cloud;
  return c;
}

class Virtual : public SourceUnderTest {
 public:
  std::unique_ptr<Source> make() override {
    DeviceParts parts;
    parts.samples = std::make_shared<FormulaLidar>(Model::vlp16, 20);
    return std::make_unique<velodyne::VirtualSource>(parts, cloud_config("{}").params);
  }
  ChannelConfig config() override { return cloud_config("{buffers: 8}"); }
  ChannelConfig config_with_unknown_key() override { return cloud_config("{no_such_key: 1}"); }
  std::size_t slots() const override { return 8; }
};

/// An emulator at ports of its own.
class Loopback : public SourceUnderTest {
 public:
  Loopback() {
    DeviceParts parts;
    parts.samples = std::make_shared<FormulaLidar>(Model::vlp16, 20);
    emulator_.attach(parts);
    const auto keys = velodyne::test::free_ports();
    keys_ = "port: " + std::to_string(keys[0]) + ", position_port: " + std::to_string(keys[1]);
    const auto first_error = [&]() -> Status {
      if (auto s = emulator_.configure(cloud_config("{" + keys_ + "}")); !s) return s;
      if (auto s = emulator_.arm({}); !s) return s;
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
    return std::make_unique<velodyne::VelodyneSource>();
  }
  ChannelConfig config() override { return cloud_config("{buffers: 8, " + keys_ + "}"); }
  ChannelConfig config_with_unknown_key() override { return cloud_config("{no_such_key: 1, " + keys_ + "}"); }

 private:
  velodyne::VelodyneEmulator emulator_;
  std::string keys_, problem_;
};

class Recording : public SourceUnderTest {
 public:
  explicit Recording(bool virtual_time) : virtual_(virtual_time) {
    velodyne::test::record_rotor(directory_.file("a.pcap"), 20, 754 * 4);
  }
  std::unique_ptr<Source> make() override { return std::make_unique<velodyne::VelodyneSource>(); }
  bool virtual_time() const override { return virtual_; }
  Duration settle() const override { return milliseconds(200); }
  std::size_t slots() const override { return 8; }
  ChannelConfig config() override {
    return cloud_config("{buffers: 8, file: " + directory_.file("a.pcap") + "}");
  }
  ChannelConfig config_with_unknown_key() override {
    return cloud_config("{no_such_key: 1, file: " + directory_.file("a.pcap") + "}");
  }

 private:
  bool virtual_;
  test::TemporaryDirectory directory_;
};
class VirtualRecording : public Recording {
 public:
  VirtualRecording() : Recording(true) {}
};
class WallRecording : public Recording {
 public:
  WallRecording() : Recording(false) {}
};

INSTANTIATE_TEST_SUITE_P(Velodyne, SourceConformance,
                         testing::Values(under_test<Virtual>("virtual_time"),
                                         under_test<Loopback>("loopback"),
                                         under_test<VirtualRecording>("recording_in_virtual_time"),
                                         under_test<WallRecording>("recording")),
                         name_of_case);

class Emulated final : public ChannelUnderTest {
 public:
  std::unique_ptr<Channel> make() override {
    auto emulator = std::make_unique<velodyne::VelodyneEmulator>();
    DeviceParts parts;
    parts.samples = std::make_shared<FormulaLidar>(Model::vlp16, 10);
    emulator->attach(parts);
    return emulator;
  }
  ChannelConfig config() override { return cloud_config("{" + keys() + "}"); }
  ChannelConfig config_with_unknown_key() override {
    return cloud_config("{no_such_key: 1, " + keys() + "}");
  }

 private:
  std::string keys() {
    const auto ports = velodyne::test::free_ports();
    return "port: " + std::to_string(ports[0]) + ", position_port: " + std::to_string(ports[1]);
  }
};
INSTANTIATE_TEST_SUITE_P(Velodyne, LifecycleConformance,
                         testing::Values(channel_under_test<Emulated>("emulator")), name_of_channel_case);

}  // namespace
}  // namespace rigor::conformance
