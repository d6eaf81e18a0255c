// A GigE Vision camera through Aravis over loopback, fed by our emulator; and the emulator itself.
#include "drivers/aravis/aravis_source.h"
#include "drivers/aravis/gige_channel_emulator.h"
#include "sensor-hal/conformance/conformance.h"
#include "tests/sensor-hal/channel/test_sources.h"

namespace rigor::conformance {
namespace {

ChannelConfig camera_config(const std::string& params) {
  return test::image_config(params, milliseconds(40), milliseconds(60));
}

class Camera final : public SourceUnderTest {
 public:
  Camera() {
    DeviceParts parts;
    parts.image = std::make_shared<test::FormulaImages>();
    emulator_.attach(parts);
    problem_ = run();
  }
  ~Camera() override { (void)emulator_.stop(); }
  std::string unavailable() override { return problem_; }
  bool virtual_time() const override { return false; }
  Duration settle() const override { return seconds(1); }
  std::size_t slots() const override { return 8; }
  std::unique_ptr<Source> make() override { return std::make_unique<AravisSource>(); }
  ChannelConfig config() override {
    return camera_config("{device: Rigor-conform71, interface: 127.0.0.1, exposure_us: 2000, buffers: 8}");
  }
  ChannelConfig config_with_unknown_key() override {
    return camera_config("{device: Rigor-conform71, interface: 127.0.0.1, no_such_key: 1}");
  }

 private:
  std::string run() {
    const auto config = camera_config("{address: 127.0.0.171, serial: conform71, rate_hz: 25}");
    if (auto s = emulator_.configure(config); !s) return "no camera to test with: " + s.error().text();
    if (auto s = emulator_.arm({}); !s) return "no camera to test with: " + s.error().text();
    if (auto s = emulator_.start(bench_now()); !s) return "no camera to test with: " + s.error().text();
    return {};
  }
  GigeChannelEmulator emulator_;
  std::string problem_;
};
INSTANTIATE_TEST_SUITE_P(Aravis, SourceConformance,
                         testing::Values(under_test<Camera>("camera_over_loopback")), name_of_case);

class CameraEmulator final : public ChannelUnderTest {
 public:
  std::unique_ptr<Channel> make() override {
    auto emulator = std::make_unique<GigeChannelEmulator>();
    DeviceParts parts;
    parts.image = std::make_shared<test::FormulaImages>();
    emulator->attach(parts);
    return emulator;
  }
  ChannelConfig config() override { return camera_config("{address: 127.0.0.172, serial: conform72}"); }
  ChannelConfig config_with_unknown_key() override {
    return camera_config("{address: 127.0.0.172, serial: conform72, no_such_key: 1}");
  }
};
INSTANTIATE_TEST_SUITE_P(Gige, LifecycleConformance,
                         testing::Values(channel_under_test<CameraEmulator>("camera_emulator")),
                         name_of_channel_case);

}  // namespace
}  // namespace rigor::conformance
