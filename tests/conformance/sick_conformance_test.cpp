// A SICK scanner: its stand-in in virtual time, the source over TCP fed by our emulator, and the emulator.
#include "drivers/sick/sick_emulator.h"
#include "drivers/sick/sick_source.h"
#include "drivers/sick/sick_virtual_source.h"
#include "sensor-hal/conformance/conformance.h"
#include "tests/drivers/sick/sick_test_tools.h"

namespace rigor::conformance {
namespace {

using sick::test::config_of;
using sick::test::FormulaScan;
using sick::test::parts_of;

class VirtualScanner final : public SourceUnderTest {
 public:
  std::unique_ptr<Source> make() override {
    return std::make_unique<sick::SickVirtualSource>(parts_of(std::make_shared<FormulaScan>()),
                                                     config_of("{}").params);
  }
  ChannelConfig config() override { return config_of("{buffers: 8}"); }
  ChannelConfig config_with_unknown_key() override { return config_of("{no_such_key: 1}"); }
  std::size_t slots() const override { return 8; }
};

class Scanner final : public SourceUnderTest {
 public:
  Scanner() {
    emulator_.attach(parts_of(std::make_shared<FormulaScan>()));
    auto s = emulator_.configure(config_of("{port: 0}"));
    if (s) s = emulator_.arm({});
    if (s) s = emulator_.start(bench_now());
    if (!s) problem_ = "no scanner to test with: " + s.error().text();
  }
  ~Scanner() override { (void)emulator_.stop(); }
  std::string unavailable() override { return problem_; }
  bool virtual_time() const override { return false; }
  Duration settle() const override { return seconds(1); }
  std::size_t slots() const override { return 8; }
  std::unique_ptr<Source> make() override { return std::make_unique<sick::SickSource>(); }
  ChannelConfig config() override { return config_of(keys("buffers: 8")); }
  ChannelConfig config_with_unknown_key() override { return config_of(keys("no_such_key: 1")); }

 private:
  std::string keys(const std::string& more) {
    return "{address: 127.0.0.1, port: " + std::to_string(emulator_.port()) + ", " + more + "}";
  }
  sick::SickEmulator emulator_;
  std::string problem_;
};
INSTANTIATE_TEST_SUITE_P(Sick, SourceConformance,
                         testing::Values(under_test<VirtualScanner>("virtual_scanner"),
                                         under_test<Scanner>("scanner_over_loopback")),
                         name_of_case);

class ScannerEmulator final : public ChannelUnderTest {
 public:
  std::unique_ptr<Channel> make() override {
    auto emulator = std::make_unique<sick::SickEmulator>();
    emulator->attach(parts_of(std::make_shared<FormulaScan>()));
    return emulator;
  }
  ChannelConfig config() override { return config_of("{port: 0}"); }
  ChannelConfig config_with_unknown_key() override { return config_of("{port: 0, no_such_key: 1}"); }
};
INSTANTIATE_TEST_SUITE_P(Sick, LifecycleConformance,
                         testing::Values(channel_under_test<ScannerEmulator>("scanner_emulator")),
                         name_of_channel_case);

}  // namespace
}  // namespace rigor::conformance
