// The suite of channels on the kernel's devices.
#include "drivers/v4l2/v4l2_emulator.h"
#include "drivers/v4l2/v4l2_source.h"
#include "sensor-hal/conformance/conformance.h"
#include "tests/drivers/v4l2/kernel_test_tools.h"

namespace rigor::conformance {
namespace {

std::string missing(bool there, const std::string& what) {
  if (there) return {};
  if (std::getenv("RIGOR_GUEST") != nullptr) ADD_FAILURE() << "this kernel has no " << what;
  return "this kernel has no " + what;
}

class VividCapture final : public SourceUnderTest {
 public:
  std::string unavailable() override { return missing(!v4l2::test::vivid().empty(), "vivid"); }
  bool virtual_time() const override { return false; }
  Duration settle() const override { return seconds(3); }
  std::size_t slots() const override { return 8; }
  std::unique_ptr<Source> make() override { return std::make_unique<v4l2::V4l2Source>(); }
  ChannelConfig config() override { return config_of(""); }
  ChannelConfig config_with_unknown_key() override { return config_of(", no_such_key: 1"); }

 private:
  static ChannelConfig config_of(const std::string& more) {
    return v4l2::test::config(
        "{device: " + v4l2::test::vivid() +
            ", pixel_format: Mono8, device_format: GREY, width_px: 320, height_px: 180, "
            "exposure_us: 1000, buffers: 8, controls: {timestamp_source: start_of_exposure}" +
            more + "}",
        milliseconds(40), milliseconds(200));
  }
};
INSTANTIATE_TEST_SUITE_P(Kernel, SourceConformance, testing::Values(under_test<VividCapture>("vivid")),
                         name_of_case);

class LoopbackEmulator final : public ChannelUnderTest {
 public:
  std::string unavailable() override { return missing(!v4l2::test::loopback().empty(), "v4l2loopback"); }
  std::unique_ptr<Channel> make() override {
    auto emulator = std::make_unique<v4l2::V4l2Emulator>();
    emulator->attach(v4l2::test::parts_of(64, 48));
    return emulator;
  }
  ChannelConfig config() override { return config_of(""); }
  ChannelConfig config_with_unknown_key() override { return config_of(", no_such_key: 1"); }

 private:
  static ChannelConfig config_of(const std::string& more) {
    return v4l2::test::config("{device: " + v4l2::test::loopback() + ", formats: [GREY], rate_hz: 10" + more +
                              "}");
  }
};
INSTANTIATE_TEST_SUITE_P(Kernel, LifecycleConformance,
                         testing::Values(channel_under_test<LoopbackEmulator>("v4l2loopback")),
                         name_of_channel_case);

}  // namespace
}  // namespace rigor::conformance
