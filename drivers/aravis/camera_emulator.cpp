#include "drivers/aravis/camera_emulator.h"

#include "drivers/aravis/gige_channel_emulator.h"
#include "drivers/aravis/u3v_channel_emulator.h"
#include "sensor-hal/channel/chosen_emulator.h"

namespace rigor {
namespace {

class CameraEmulator final : public ChosenEmulator {
 public:
  CameraEmulator() : ChosenEmulator("camera") {}

 protected:
  [[nodiscard]] std::unique_ptr<Emulator> choose(const ConfigNode& params) const override {
    if (params.choice_or("as", {"gige", "usb3vision"}, "gige") == "usb3vision")
      return std::make_unique<U3vChannelEmulator>();
    return std::make_unique<GigeChannelEmulator>();
  }
};

}  // namespace

std::unique_ptr<Emulator> make_camera_emulator() { return std::make_unique<CameraEmulator>(); }

}  // namespace rigor
