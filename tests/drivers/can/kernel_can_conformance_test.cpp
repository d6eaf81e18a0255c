// The conformance suite of channels over a real kernel's vcan interface: the emulated node sends.
#include "drivers/can/can_emulator.h"
#include "drivers/can/can_sink.h"
#include "drivers/can/can_source.h"
#include "sensor-hal/conformance/conformance.h"
#include "tests/drivers/can/kernel_can_tools.h"

namespace rigor::conformance {
namespace {

using can::test::config_of;

constexpr const char* kBus = "rigorconf0";

class Node {
 public:
  std::string unavailable() {
    auto why = can::test::no_vcan();
    if (!why.empty() && can::test::in_guest()) ADD_FAILURE() << why;
    return why;
  }
  void start() {
    (void)can::create_vcan(kBus);
    emulator_.attach({.image = {},
                      .samples = {},
                      .motion = {},
                      .registers = {},
                      .signals = std::make_shared<can::test::CountingModel>()});
    auto s =
        emulator_.configure(config_of(SampleKind::none, std::string("{interface: ") + kBus +
                                                            ", node: Device, dbc: " + folder_.dbc() + "}"));
    if (s) s = emulator_.arm({});
    if (s) s = emulator_.start(bench_now());
    EXPECT_TRUE(s) << s.error().text();
  }
  ~Node() {
    if (emulator_.state() == ChannelState::running) (void)emulator_.stop();
    (void)can::remove_interface(kBus);
  }
  std::string dbc() const { return folder_.dbc(); }

 private:
  can::test::Folder folder_;
  can::CanEmulator emulator_;
};

class RawFrames : public SourceUnderTest {
 public:
  std::unique_ptr<Source> make() override {
    node_.start();
    return std::make_unique<can::CanSource>();
  }
  ChannelConfig config() override { return of("slots: 16"); }
  ChannelConfig config_with_unknown_key() override { return of("no_such_key: 1"); }
  bool virtual_time() const override { return false; }
  std::size_t slots() const override { return 16; }
  std::string unavailable() override { return node_.unavailable(); }

 private:
  static ChannelConfig of(const std::string& more) {
    return config_of(SampleKind::can_frame, std::string("{interface: ") + kBus + ", " + more + "}", {},
                     milliseconds(3));
  }
  Node node_;
};

class Signals : public SourceUnderTest {
 public:
  std::unique_ptr<Source> make() override {
    node_.start();
    return std::make_unique<can::CanSource>();
  }
  ChannelConfig config() override { return of("slots: 16"); }
  ChannelConfig config_with_unknown_key() override { return of("no_such_key: 1"); }
  bool virtual_time() const override { return false; }
  std::size_t slots() const override { return 16; }
  std::string unavailable() override { return node_.unavailable(); }

 private:
  ChannelConfig of(const std::string& more) const {
    return config_of(SampleKind::register_block,
                     std::string("{interface: ") + kBus + ", dbc: " + node_.dbc() +
                         ", signals: [{message: Clock, signal: clock_ms}], " + more + "}",
                     milliseconds(10), milliseconds(5));
  }
  Node node_;
};
INSTANTIATE_TEST_SUITE_P(KernelCan, SourceConformance,
                         testing::Values(under_test<RawFrames>("frames"), under_test<Signals>("signals")),
                         name_of_case);

class Commands : public ChannelUnderTest {
 public:
  std::unique_ptr<Channel> make() override {
    node_.start();
    return std::make_unique<can::CanSink>();
  }
  ChannelConfig config() override { return of("announce: true"); }
  ChannelConfig config_with_unknown_key() override { return of("no_such_key: 1"); }
  std::string unavailable() override { return node_.unavailable(); }

 private:
  ChannelConfig of(const std::string& more) const {
    return config_of(SampleKind::none,
                     std::string("{interface: ") + kBus + ", dbc: " + node_.dbc() +
                         ", signals: [{message: Command, signal: enable}], safe: {enable: 0}, " + more + "}");
  }
  Node node_;
};

class Device : public ChannelUnderTest {
 public:
  std::unique_ptr<Channel> make() override {
    (void)can::create_vcan(kBus);
    auto emulator = std::make_unique<can::CanEmulator>();
    emulator->attach({.image = {},
                      .samples = {},
                      .motion = {},
                      .registers = {},
                      .signals = std::make_shared<can::test::CountingModel>()});
    return emulator;
  }
  ChannelConfig config() override { return of("create: true"); }
  ChannelConfig config_with_unknown_key() override { return of("no_such_key: 1"); }
  std::string unavailable() override { return node_.unavailable(); }

 private:
  ChannelConfig of(const std::string& more) const {
    return config_of(SampleKind::none, std::string("{interface: ") + kBus + ", dbc: " + node_.dbc() +
                                           ", node: Device, " + more + "}");
  }
  Node node_;
};
INSTANTIATE_TEST_SUITE_P(KernelCan, LifecycleConformance,
                         testing::Values(channel_under_test<Commands>("sink"),
                                         channel_under_test<Device>("emulator")),
                         name_of_channel_case);
INSTANTIATE_TEST_SUITE_P(KernelCan, SinkConformance, testing::Values(channel_under_test<Commands>("sink")),
                         name_of_channel_case);

}  // namespace
}  // namespace rigor::conformance
