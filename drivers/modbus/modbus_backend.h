// `backend: modbus`.
#pragma once

#include "sensor-hal/channel/registry.h"

namespace rigor {
/// Source, sink and emulator over TCP, and their stand-ins for virtual time. All stand-ins that one backend
/// object (or a copy of it) makes for the same register model share one device and its order of events.
[[nodiscard]] Backend modbus_backend();
}  // namespace rigor
