// Cameras by way of Aravis, for the registry: source, emulator, stand-in for virtual time, discovery, doctor.
#pragma once

#include "sensor-hal/channel/registry.h"

namespace rigor {

[[nodiscard]] Backend aravis_backend();

}  // namespace rigor
