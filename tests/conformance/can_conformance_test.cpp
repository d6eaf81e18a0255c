// Channels and sinks of a CAN bus in virtual time. On a real interface:
// tests/drivers/can/kernel_can_conformance_test.cpp.
#include "rt-core/heartbeat.h"
#include "sensor-hal/conformance/conformance.h"
#include "tests/drivers/can/can_test_tools.h"

namespace rigor::conformance {
namespace {

using can::test::config_of;

class Bus {
 public:
  std::shared_ptr<can::NodeOnBus> node() {
    DeviceParts parts;
    parts.signals = model_;
    auto made = buses_.node(
        parts, can::test::node_of("{interface: vcan0, node: Device, dbc: " + folder_.dbc() + "}"));
    EXPECT_TRUE(made) << (made ? "" : made.error().text());
    return made ? *made : nullptr;
  }
  std::string dbc() const { return folder_.dbc(); }

 private:
  can::test::Folder folder_;
  std::shared_ptr<can::test::CountingModel> model_ = std::make_shared<can::test::CountingModel>();
  can::VirtualBuses buses_;
};

class RawFrames : public SourceUnderTest {
 public:
  std::unique_ptr<Source> make() override { return can::make_virtual_source(bus_.node()); }
  ChannelConfig config() override { return of("{interface: vcan0, slots: 8}"); }
  ChannelConfig config_with_unknown_key() override { return of("{interface: vcan0, no_such_key: 1}"); }
  std::size_t slots() const override { return 8; }

 private:
  static ChannelConfig of(const std::string& params) {
    return config_of(SampleKind::can_frame, params, {}, milliseconds(3));
  }
  Bus bus_;
};

class Signals : public SourceUnderTest {
 public:
  std::unique_ptr<Source> make() override { return can::make_virtual_source(bus_.node()); }
  ChannelConfig config() override { return of("slots: 8"); }
  ChannelConfig config_with_unknown_key() override { return of("no_such_key: 1"); }
  std::size_t slots() const override { return 8; }

 private:
  ChannelConfig of(const std::string& more) const {
    return config_of(
        SampleKind::register_block,
        "{interface: vcan0, dbc: " + bus_.dbc() +
            ", signals: [{message: Clock, signal: clock_ms}, {message: State, signal: state}], " + more + "}",
        milliseconds(10), milliseconds(5));
  }
  Bus bus_;
};

INSTANTIATE_TEST_SUITE_P(Can, SourceConformance,
                         testing::Values(under_test<RawFrames>("virtual_frames"),
                                         under_test<Signals>("virtual_signals")),
                         name_of_case);

class Commands : public ChannelUnderTest {
 public:
  std::unique_ptr<Channel> make() override {
    auto sink = can::make_virtual_sink(bus_.node());
    heartbeat_.restart(true);
    sink->watch(&heartbeat_, milliseconds(100));
    return sink;
  }
  ChannelConfig config() override { return of("announce: true"); }
  ChannelConfig config_with_unknown_key() override { return of("no_such_key: 1"); }
  bool virtual_time() const override { return true; }

 private:
  ChannelConfig of(const std::string& more) const {
    return config_of(SampleKind::none,
                     "{interface: vcan0, dbc: " + bus_.dbc() +
                         ", signals: [{message: Command, signal: enable}], safe: {enable: 0}, " + more + "}");
  }
  Bus bus_;
  Heartbeat heartbeat_;
};
INSTANTIATE_TEST_SUITE_P(Can, LifecycleConformance,
                         testing::Values(channel_under_test<Commands>("virtual_sink")), name_of_channel_case);

}  // namespace
}  // namespace rigor::conformance
