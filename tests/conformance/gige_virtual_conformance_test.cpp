// The stand-in for a GigE Vision camera in virtual time: model and codec in process.
#include "drivers/aravis/gige_virtual_source.h"
#include "sensor-hal/conformance/conformance.h"
#include "tests/sensor-hal/channel/test_sources.h"

namespace rigor::conformance {
namespace {

class VirtualCamera : public SourceUnderTest {
 public:
  std::unique_ptr<Source> make() override {
    DeviceParts parts;
    parts.image = std::make_shared<test::FormulaImages>();
    parts.motion = std::make_shared<test::TurningJoint>();
    return std::make_unique<GigeVirtualSource>(parts, config_of("{serial: left}").params);
  }
  ChannelConfig config() override { return config_of("{device: Rigor-left, exposure_us: 2000, buffers: 8}"); }
  ChannelConfig config_with_unknown_key() override {
    return config_of("{device: Rigor-left, no_such_key: 1}");
  }
  std::size_t slots() const override { return 8; }

 private:
  static ChannelConfig config_of(const std::string& params) {
    return test::image_config(params, milliseconds(40), milliseconds(50));
  }
};
INSTANTIATE_TEST_SUITE_P(Gige, SourceConformance,
                         testing::Values(under_test<VirtualCamera>("virtual_camera")), name_of_case);

}  // namespace
}  // namespace rigor::conformance
