// The stand-in for a video device in virtual time: the emulated camera in process. The wall-clock side runs
// where the kernel has the devices: tests/drivers/v4l2/kernel_conformance_test.cpp.
#include "drivers/v4l2/v4l2_virtual_source.h"
#include "sensor-hal/conformance/conformance.h"
#include "tests/sensor-hal/channel/test_sources.h"

namespace rigor::conformance {
namespace {

template <int Format>
class VirtualVideo final : public SourceUnderTest {
 public:
  std::unique_ptr<Source> make() override {
    DeviceParts parts;
    parts.image = std::make_shared<test::FormulaImages>();
    parts.motion = std::make_shared<test::TurningJoint>();
    return std::make_unique<v4l2::VirtualSource>(
        parts,
        config_of(Format == 0 ? "{formats: [GREY]}" : "{formats: [YUYV], timestamp: start_of_exposure}")
            .params);
  }
  ChannelConfig config() override { return config_of(keys("")); }
  ChannelConfig config_with_unknown_key() override { return config_of(keys(", no_such_key: 1")); }
  std::size_t slots() const override { return 8; }

 private:
  static std::string keys(const std::string& more) {
    return std::string("{device: camera, buffers: 8, width_px: 64, height_px: 48, pixel_format: ") +
           (Format == 0 ? "Mono8" : "RGB8") + more + "}";
  }
  static ChannelConfig config_of(const std::string& params) {
    return test::image_config(params, milliseconds(40), milliseconds(50));
  }
};
INSTANTIATE_TEST_SUITE_P(V4l2, SourceConformance,
                         testing::Values(under_test<VirtualVideo<0>>("virtual_grey"),
                                         under_test<VirtualVideo<1>>("virtual_converted")),
                         name_of_case);

}  // namespace
}  // namespace rigor::conformance
