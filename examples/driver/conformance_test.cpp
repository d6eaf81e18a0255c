// What every source of Rigor has to do, asked of this one.
#include "sensor-hal/conformance/conformance.h"

#include "text_sensor.h"

namespace rigor::conformance {
namespace {

ChannelConfig config_of(const std::string& keys) {
  ChannelConfig c;
  c.name = "range";
  c.kind = SampleKind::register_block;
  c.period = milliseconds(20);
  c.latency = milliseconds(5);
  c.params = *ConfigDocument::parse(keys);
  return c;
}

class InVirtualTime final : public SourceUnderTest {
 public:
  std::unique_ptr<Source> make() override { return std::make_unique<text_sensor::VirtualSource>(); }
  ChannelConfig config() override { return config_of("{port: 20778}"); }
  ChannelConfig config_with_unknown_key() override { return config_of("{port: 20778, no_such_key: 1}"); }
  std::size_t slots() const override { return 16; }
};

class OverLoopback final : public SourceUnderTest {
 public:
  OverLoopback() {
    auto s = emulator_.configure(config_of("{port: 20778, rate_hz: 50}"));
    if (s) s = emulator_.arm({});
    if (s) s = emulator_.start(bench_now());
    if (!s) problem_ = s.error().text();
  }
  ~OverLoopback() override { (void)emulator_.stop(); }
  std::string unavailable() override { return problem_; }
  bool virtual_time() const override { return false; }
  std::unique_ptr<Source> make() override { return std::make_unique<text_sensor::NetworkSource>(); }
  ChannelConfig config() override { return config_of("{port: 20778}"); }
  ChannelConfig config_with_unknown_key() override { return config_of("{port: 20778, no_such_key: 1}"); }
  Duration settle() const override { return milliseconds(200); }
  std::size_t slots() const override { return 16; }

 private:
  text_sensor::TextEmulator emulator_;
  std::string problem_;
};

INSTANTIATE_TEST_SUITE_P(TextSensor, SourceConformance,
                         testing::Values(under_test<InVirtualTime>("virtual"),
                                         under_test<OverLoopback>("over_loopback")),
                         name_of_case);

}  // namespace
}  // namespace rigor::conformance
