// The backend `can` for the registry: SocketCAN source, sink, emulated node, and their stand-ins in virtual
// time.
#pragma once

#include "sensor-hal/channel/registry.h"

namespace rigor {

[[nodiscard]] Backend can_backend();

}  // namespace rigor
