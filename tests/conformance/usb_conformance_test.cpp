// Scanners and bulk frames under the suite that every backend passes: over a pseudo-terminal and a socket,
// and in virtual time.
#include "drivers/usb/usb_protocols.h"
#include "sensor-hal/conformance/conformance.h"
#include "tests/drivers/usb/usb_test_tools.h"
#include "tests/sensor-hal/channel/test_sources.h"

namespace rigor::conformance {
namespace {

using usb::testing::RunningEmulator;
using usb::testing::scanner_config;

class ScannerOverPty final : public SourceUnderTest {
 public:
  std::string unavailable() override {
    EXPECT_EQ(emulator_.problem, "");
    return {};
  }
  bool virtual_time() const override { return false; }
  Duration settle() const override { return milliseconds(300); }
  std::size_t slots() const override { return 16; }
  std::unique_ptr<Source> make() override { return usb::make_usb_source(usb::make_plain_link); }
  ChannelConfig config() override { return scanner_config(emulator_.tty()); }
  ChannelConfig config_with_unknown_key() override {
    return scanner_config(emulator_.tty_with("no_such_key: 1"));
  }

 private:
  RunningEmulator emulator_{"{as: pty, model: utm-30lx}"};
};

class ScannerInVirtualTime final : public SourceUnderTest {
 public:
  std::size_t slots() const override { return 16; }
  std::unique_ptr<Source> make() override {
    DeviceParts parts;
    parts.samples = std::make_shared<usb::testing::FormulaScans>(usb::utm_30lx());
    return usb::make_usb_virtual_source(parts, scanner_config("{model: utm-30lx}").params);
  }
  ChannelConfig config() override { return scanner_config("{protocol: scip, intensity: true}"); }
  ChannelConfig config_with_unknown_key() override { return scanner_config("{no_such_key: 1}"); }
};

const std::string kFrame =
    "protocol: bulk, frame: {magic: 52474654, header_bytes: 24, width_px: 16, height_px: 12, "
    "sequence: {at: 4, type: u32}, stamp: {at: 8, type: u64, tick_ns: 1000}, "
    "length: {at: 16, type: u32}, planes: [{name: range, scale: 0.001, invalid: 0}, {name: amplitude, type: "
    "f32}]}";

ChannelConfig frames(const std::string& keys) {
  ChannelConfig c = scanner_config("{" + kFrame + ", " + keys + "}");
  c.kind = SampleKind::range_image;
  return c;
}
DeviceParts range_images() {
  DeviceParts parts;
  parts.samples = std::make_shared<test::FormulaSamples>(SampleKind::range_image);
  return parts;
}

class FramesOverTcp final : public SourceUnderTest {
 public:
  FramesOverTcp() {
    emulator_.attach(range_images());
    Status s = emulator_.configure(frames("as: tcp, port: 0, rate_hz: 40"));
    if (s) s = emulator_.arm({});
    if (s) s = emulator_.start(bench_now());
    if (!s) problem_ = s.error().text();
    where_ = "transport: tcp, address: 127.0.0.1, port: " +
             emulator_.where().substr(emulator_.where().find(':') + 1);
  }
  std::string unavailable() override {
    EXPECT_EQ(problem_, "");
    return {};
  }
  bool virtual_time() const override { return false; }
  Duration settle() const override { return milliseconds(300); }
  std::size_t slots() const override { return 16; }
  std::unique_ptr<Source> make() override { return usb::make_usb_source(usb::make_plain_link); }
  ChannelConfig config() override { return frames(where_); }
  ChannelConfig config_with_unknown_key() override { return frames(where_ + ", no_such_key: 1"); }

 private:
  usb::BulkEmulator emulator_;
  std::string problem_, where_;
};

class FramesInVirtualTime final : public SourceUnderTest {
 public:
  std::size_t slots() const override { return 16; }
  std::unique_ptr<Source> make() override { return usb::make_usb_virtual_source(range_images(), {}); }
  ChannelConfig config() override { return frames("vendor: 1, product: 2"); }
  ChannelConfig config_with_unknown_key() override { return frames("vendor: 1, product: 2, no_such_key: 1"); }
};

INSTANTIATE_TEST_SUITE_P(Usb, SourceConformance,
                         testing::Values(under_test<ScannerOverPty>("scanner_over_pty"),
                                         under_test<ScannerInVirtualTime>("scanner_in_virtual_time"),
                                         under_test<FramesOverTcp>("frames_over_tcp"),
                                         under_test<FramesInVirtualTime>("frames_in_virtual_time")),
                         name_of_case);

class ScannerEmulator final : public ChannelUnderTest {
 public:
  std::unique_ptr<Channel> make() override {
    auto emulator = usb::make_usb_emulator();
    DeviceParts parts;
    parts.samples = std::make_shared<usb::testing::FormulaScans>(usb::urg_04lx());
    emulator->attach(parts);
    return emulator;
  }
  ChannelConfig config() override { return scanner_config("{as: pty}"); }
  ChannelConfig config_with_unknown_key() override {
    return scanner_config("{as: tcp, port: 0, no_such_key: 1}");
  }
};
class FramesEmulator final : public ChannelUnderTest {
 public:
  std::unique_ptr<Channel> make() override {
    auto emulator = usb::make_usb_emulator();
    emulator->attach(range_images());
    return emulator;
  }
  ChannelConfig config() override { return frames("as: tcp, port: 0"); }
  ChannelConfig config_with_unknown_key() override { return frames("as: tcp, port: 0, no_such_key: 1"); }
};
INSTANTIATE_TEST_SUITE_P(Usb, LifecycleConformance,
                         testing::Values(channel_under_test<ScannerEmulator>("scanner_emulator"),
                                         channel_under_test<FramesEmulator>("frames_emulator")),
                         name_of_channel_case);

}  // namespace
}  // namespace rigor::conformance
