// The emulator of backend aravis: a GigE Vision or a USB3 Vision camera, as the rig's `as` says.
#pragma once

#include <memory>

#include "sensor-hal/channel/emulator.h"

namespace rigor {

[[nodiscard]] std::unique_ptr<Emulator> make_camera_emulator();

}  // namespace rigor
