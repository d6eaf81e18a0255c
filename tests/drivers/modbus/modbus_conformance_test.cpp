// Modbus channels under the suite that every backend passes.
#include "drivers/modbus/modbus_backend.h"
#include "drivers/modbus/modbus_sink.h"
#include "drivers/modbus/modbus_source.h"
#include "sensor-hal/conformance/conformance.h"
#include "tests/drivers/modbus/modbus_test_tools.h"

namespace rigor::conformance {
namespace {

using modbus::Bank;
using modbus::Device;
using modbus::yaml;

const std::string kSource =
    "registers: [{ name: a, table: input_registers, address: 0, type: s32, unit: deg }]\n";
const std::string kSink = "registers: [{ name: a, table: holding_registers, address: 0 }]\nsafe: { a: 0 }\n";
const std::string kStrange = "no_such_key: 1\n";

ChannelConfig channel(const std::string& keys, std::uint16_t port) {
  ChannelConfig c;
  c.name = "table";
  c.kind = SampleKind::register_block;
  c.period = milliseconds(10);
  c.latency = milliseconds(5);
  c.params = yaml("address: 127.0.0.1\nport: " + std::to_string(port) + "\n" + keys);
  return c;
}

class TcpSource final : public SourceUnderTest {
 public:
  std::unique_ptr<Source> make() override { return std::make_unique<modbus::ModbusSource>(); }
  ChannelConfig config() override { return channel(kSource, device_.port()); }
  ChannelConfig config_with_unknown_key() override { return channel(kSource + kStrange, device_.port()); }
  [[nodiscard]] bool virtual_time() const override { return false; }
  [[nodiscard]] std::size_t slots() const override { return modbus::pool_slots(channel(kSource, 1)); }

 private:
  Device device_{std::make_shared<Bank>()};
};

class VirtualSource final : public SourceUnderTest {
 public:
  std::unique_ptr<Source> make() override {
    return std::move(*modbus_backend().make_virtual_source(modbus::parts_of(std::make_shared<Bank>()), {}));
  }
  ChannelConfig config() override { return channel(kSource, 502); }
  ChannelConfig config_with_unknown_key() override { return channel(kSource + kStrange, 502); }
  [[nodiscard]] std::size_t slots() const override { return modbus::pool_slots(channel(kSource, 1)); }
};

INSTANTIATE_TEST_SUITE_P(Modbus, SourceConformance,
                         testing::Values(under_test<TcpSource>("tcp"), under_test<VirtualSource>("virtual")),
                         name_of_case);

class TcpSink final : public ChannelUnderTest {
 public:
  std::unique_ptr<Channel> make() override { return std::make_unique<modbus::ModbusSink>(); }
  ChannelConfig config() override { return channel(kSink, device_.port()); }
  ChannelConfig config_with_unknown_key() override { return channel(kSink + kStrange, device_.port()); }

 private:
  Device device_{std::make_shared<Bank>()};
};

class VirtualSink final : public ChannelUnderTest {
 public:
  std::unique_ptr<Channel> make() override {
    return std::move(*modbus_backend().make_virtual_sink(modbus::parts_of(std::make_shared<Bank>()), {}));
  }
  ChannelConfig config() override { return channel(kSink, 502); }
  ChannelConfig config_with_unknown_key() override { return channel(kSink + kStrange, 502); }
  [[nodiscard]] bool virtual_time() const override { return true; }
};

class TcpEmulator final : public ChannelUnderTest {
 public:
  std::unique_ptr<Channel> make() override {
    auto e = std::make_unique<modbus::ModbusEmulator>();
    e->attach(modbus::parts_of(std::make_shared<Bank>()));
    return e;
  }
  ChannelConfig config() override { return channel("", 0); }
  ChannelConfig config_with_unknown_key() override { return channel(kStrange, 0); }
};

INSTANTIATE_TEST_SUITE_P(Modbus, LifecycleConformance,
                         testing::Values(channel_under_test<TcpSink>("tcp_sink"),
                                         channel_under_test<VirtualSink>("virtual_sink"),
                                         channel_under_test<TcpEmulator>("emulator")),
                         name_of_channel_case);
INSTANTIATE_TEST_SUITE_P(Modbus, SinkConformance, testing::Values(channel_under_test<TcpSink>("tcp_sink")),
                         name_of_channel_case);

}  // namespace
}  // namespace rigor::conformance
